import { useEffect, useState } from "preact/hooks";
import { Field } from "./Field";
import type { Live } from "./live";
import {
  type Between,
  currentSequence,
  type Order,
  type Sequence as SequenceState,
  sequences,
  useSecondsLeft,
  type Wish,
} from "./sequence";
import { sequenceWords as words } from "./sequenceWords";

/** Where one is and what to do there, above the large button. */
export function SequenceGuide({ live }: { live: Live }) {
  const sequence = currentSequence(live);
  const left = useSecondsLeft(sequence);
  if (!sequence || sequence.state === "planned" || sequence.state === "cancelled") return null;
  const { state, session, position } = sequence;
  const tell = (wish: Wish, about: number | null = null) => void live.attempt(sequences.tell(session, wish, about));
  const stops = state === "paused" || state === "asking" || state === "done" || sequence.pausing;
  // A countdown is counted here; its sentence would be out of date.
  const said = left === null ? sequence.words : sequence.guide;
  return (
    <div class="guide" data-state={state}>
      <p aria-live="polite">{said}</p>
      {left !== null && <p class="seconds">{words.inSeconds(left)}</p>}
      {state !== "done" && (
        <div class="actions">
          {stops ? (
            sequence.pausing && (
              <button type="button" onClick={() => tell("resume")}>
                {words.resume}
              </button>
            )
          ) : (
            <button type="button" onClick={() => tell("pause")}>
              {words.pause}
            </button>
          )}
          {state !== "shooting" && (
            <button type="button" onClick={() => tell("skip", position)}>
              {words.skip}
            </button>
          )}
        </div>
      )}
    </div>
  );
}

export function Sequence({ live }: { live: Live }) {
  const sequence = currentSequence(live);
  const session = live.state?.session ?? null;
  return (
    <section class="sequence" aria-label={words.sequence}>
      {sequence ? (
        <>
          <h2>{words.sequence}</h2>
          <Course live={live} sequence={sequence} />
        </>
      ) : (
        <details>
          <summary>{words.planOne}</summary>
          {session === null ? (
            <p class="dim">{words.needsSession}</p>
          ) : (
            <PlanForm key={session} live={live} session={session} />
          )}
        </details>
      )}
    </section>
  );
}

/** How far it is. */
function Course({ live, sequence }: { live: Live; sequence: SequenceState }) {
  const { session, state, plan, done } = sequence;
  const over = state === "done" || state === "cancelled";
  return (
    <>
      <p>{words.progress(done, plan.positions)}</p>
      <ol class="places">
        {sequence.positions.map(({ position, accepted, skipped }) => {
          const stands =
            accepted !== null ? "done" : skipped ? "skipped" : position === sequence.position ? "here" : "missing";
          const label = words.place(position, words.placeStates[stands]);
          return <li key={position} class={stands} title={label} aria-label={label} />;
        })}
      </ol>
      {(state === "planned" || over) && <p class="dim">{sequence.words}</p>}
      <div class="actions">
        {state === "planned" && (
          <button type="button" onClick={() => void live.attempt(sequences.tell(session, "start"))}>
            {words.start}
          </button>
        )}
        {over || state === "planned" ? (
          <button type="button" class="quiet" onClick={() => void live.attempt(sequences.remove(session))}>
            {words.remove}
          </button>
        ) : (
          <button type="button" class="quiet" onClick={() => void live.attempt(sequences.tell(session, "cancel"))}>
            {words.cancel}
          </button>
        )}
      </div>
    </>
  );
}

function PlanForm({ live, session }: { live: Live; session: string }) {
  const [positions, setPositions] = useState("24");
  const [kind, setKind] = useState<Between["kind"]>("prompt");
  const [seconds, setSeconds] = useState("8");
  const [interval, setLeast] = useState("0");
  const [order, setOrder] = useState<Order>("off_on");
  const [offFrames, setOffFrames] = useState("1");
  const [sending, setSending] = useState(false);
  useEffect(() => setSending(false), [session]);

  const plan = async () => {
    setSending(true);
    const between: Between = kind === "countdown" ? { kind, seconds: Number(seconds) } : { kind };
    await live.attempt(
      sequences.plan(session, {
        positions: Number(positions),
        between,
        interval_s: Number(interval),
        retries: 0,
        order,
        off_frames: Number(offFrames),
        instructions: [],
      }),
    );
    setSending(false);
  };
  return (
    <form
      onSubmit={(event) => {
        event.preventDefault();
        void plan();
      }}
    >
      <p class="dim">{words.explain}</p>
      <Field whole label={words.positions} value={positions} least={1} most={1000} onChange={setPositions} />
      <label>
        {words.between}
        <select value={kind} onChange={(event) => setKind(event.currentTarget.value as Between["kind"])}>
          {Object.entries(words.kinds).map(([name, label]) => (
            <option key={name} value={name}>
              {label}
            </option>
          ))}
        </select>
      </label>
      {kind === "countdown" && (
        <Field whole label={words.seconds} value={seconds} least={0} most={3600} onChange={setSeconds} />
      )}
      <Field whole label={words.interval} value={interval} least={0} most={86400} onChange={setLeast} />
      <label>
        {words.order}
        <select value={order} onChange={(event) => setOrder(event.currentTarget.value as Order)}>
          {Object.entries(words.orders).map(([name, label]) => (
            <option key={name} value={name}>
              {label}
            </option>
          ))}
        </select>
      </label>
      <Field whole label={words.offFrames} value={offFrames} least={1} most={16} onChange={setOffFrames} />
      <button type="submit" disabled={sending}>
        {words.plan}
      </button>
    </form>
  );
}
