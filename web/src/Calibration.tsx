import { useEffect, useState } from "preact/hooks";
import { type Calibration as State, calibrations, type Kind } from "./calibration";
import { Guide } from "./CalibrationGuide";
import { calibrationWords as words } from "./calibrationWords";
import { Lighting } from "./Lighting";
import type { Live } from "./live";

/** All calibrations of the session, each with its guide. */
export function Calibration({ live }: { live: Live }) {
  const [open, setOpen] = useState(false);
  const [shown, setShown] = useState<Kind | null>(null);
  const [states, setStates] = useState<State[] | null>(null);
  const session = live.session?.name ?? null;
  useEffect(() => setStates(null), [session]);
  useEffect(() => {
    if (!open || session === null) return;
    const end = new AbortController();
    void live.attempt(calibrations.all(session, end.signal).then(setStates, (error: unknown) => {
      if (!end.signal.aborted) throw error;
    }));
    return () => end.abort();
  }, [open, session, live.calibrated]);

  const measured = states?.filter((state) => state.measured).length ?? 0;
  return (
    <section class="calibration" aria-labelledby="calibration">
      <details open={open} onToggle={(event) => setOpen(event.currentTarget.open)}>
        <summary>
          <h2 id="calibration">{words.calibrate}</h2>
          {states && <span class="dim">{words.state(measured, states.length)}</span>}
        </summary>
        {session === null && <p class="dim">{words.needsSession}</p>}
        {live.session && open && <Lighting live={live} session={live.session} />}
        <ul>
          {session !== null &&
            states?.map((state) => (
              <li key={state.kind}>
                <button
                  type="button"
                  class="kind"
                  aria-expanded={shown === state.kind}
                  aria-controls={`guide-${state.kind}`}
                  onClick={() => setShown(shown === state.kind ? null : state.kind)}
                >
                  <span>{state.guide.title}</span>
                  <Stands state={state} />
                </button>
                {shown === state.kind && (
                  <Guide key={`${session}/${state.kind}`} live={live} session={session} state={state} />
                )}
              </li>
            ))}
        </ul>
      </details>
    </section>
  );
}

function Stands({ state }: { state: State }) {
  const { measured, shots } = state;
  const fresh = shots.some((shot) => !shot.in_record);
  if (measured) {
    return <span class={measured.good ? "accepted" : "rejected"}>{words.states[measured.good ? "good" : "bad"]}</span>;
  }
  return <span class="dim">{fresh ? words.states.waiting : words.states.none}</span>;
}
