import { useEffect, useState } from "preact/hooks";
import { type Calibration, type CalibrationRecord, calibrations, type Kind, type Take } from "./calibration";
import { Drawing } from "./CalibrationDrawing";
import { calibrationWords as words, keyFigures } from "./calibrationWords";
import { JobLine } from "./Jobs";
import type { Live } from "./live";

interface Props {
  live: Live;
  session: string;
  state: Calibration;
}

/** One calibration from set-up to verdict. */
export function Guide({ live, session, state }: Props) {
  const { kind, guide } = state;
  const [distance, setDistance] = useState("");
  const about = [`calibrate_${kind}`, "calibration_shot", "flash_shots"];
  const running = live.jobs.filter(
    (job) => job.session === session && about.includes(job.kind) && (job.state === "running" || job.state === "queued"),
  );
  return (
    <div class="guided" id={`guide-${kind}`}>
      <div class="setup">
        <Drawing kind={kind} />
        <div>
          <p class="dim">{guide.gives}</p>
          <ol>
            {guide.steps.map((step) => (
              <li key={step}>{step}</li>
            ))}
          </ol>
        </div>
      </div>
      {kind === "flash" && (
        <Field label={words.distance} value={distance} least={0.05} most={99} onChange={setDistance} />
      )}
      <div class="takes">
        {guide.takes.map((take) => (
          <TakeOne key={take.role} {...{ live, session, kind, take, distance }} />
        ))}
      </div>
      {running.length > 0 && (
        <ul class="jobs" aria-live="polite">
          {running.map((job) => (
            <JobLine key={job.id} job={job} live={live} />
          ))}
        </ul>
      )}
      <Shots live={live} session={session} state={state} />
      <Fit live={live} session={session} state={state} busy={running.some((job) => job.kind === about[0])} />
      <Result live={live} session={session} state={state} />
      <details class="terminal">
        <summary class="dim">{words.terminal}</summary>
        <code>{guide.command}</code>
      </details>
    </div>
  );
}

/** Frames of one role: how, the button, and the field for files. */
function TakeOne(props: { live: Live; session: string; kind: Kind; take: Take; distance: string }) {
  const { live, session, kind, take } = props;
  const [sending, setSending] = useState(false);
  const placed = kind === "flash" ? { distance_m: Number(props.distance) } : {};
  const send = async (field: HTMLInputElement) => {
    const files = [...(field.files ?? [])];
    if (files.length === 0) return;
    setSending(true);
    // The lit frames of a card are sent one by one: each is a shot of its own.
    const parts = kind === "flash" ? files.map((file) => [file]) : [files];
    for (const part of parts) {
      const kept = await live.attempt(calibrations.send(session, kind, take.role, part, placed.distance_m));
      if (!kept) break;
    }
    field.value = "";
    setSending(false);
  };
  return (
    <fieldset>
      <legend>
        {take.name} <span class="dim">{take.count}</span>
      </legend>
      <p class="dim">{take.words}</p>
      <div class="actions">
        <button
          type="button"
          disabled={live.rigJob !== null}
          onClick={() => void live.attempt(calibrations.shoot(session, kind, { role: take.role, ...placed }))}
        >
          {kind === "flash" ? words.shootCard : words.shoot}
        </button>
        <label>
          <span class="dim">{sending ? words.sending : kind === "flash" ? words.sendCards : words.send}</span>
          <input
            type="file"
            multiple
            disabled={sending}
            accept=".cr2,.cr3,.nef,.arw,.raf,.rw2,.orf,.dng"
            onChange={(event) => void send(event.currentTarget)}
          />
        </label>
      </div>
    </fieldset>
  );
}

function Shots({ live, session, state }: Props) {
  const { kind, guide, shots } = state;
  const name = (role: string) => guide.takes.find((take) => take.role === role)?.name ?? role;
  return (
    <section aria-label={words.shots}>
      <h3>{words.shots}</h3>
      {shots.length === 0 && <p class="dim">{words.noShots}</p>}
      <ol class="shots" aria-live="polite">
        {shots.map((shot, i) => (
          <li key={shot.id}>
            <span>
              {words.shot(name(shot.role), shot.exposure)}
              {shot.distance_m != null && ` ${words.metres(shot.distance_m)}`}
            </span>
            <span class="dim">
              {shot.mean_share != null && words.mean(Math.max(0, shot.mean_share))}
              {shot.clipped_share != null && shot.clipped_share > 0 && words.clipped(shot.clipped_share)}
              {shot.in_record && words.used}
            </span>
            {!shot.in_record && (
              <button
                type="button"
                class="quiet"
                aria-label={words.removeShot(i + 1, name(shot.role))}
                onClick={() => void live.attempt(calibrations.remove(session, kind, shot.id))}
              >
                {words.remove}
              </button>
            )}
            {shot.mean_share != null && (
              <meter min={0} max={1} value={Math.max(0, shot.mean_share)} aria-label={words.mean(shot.mean_share)} />
            )}
            {shot.reasons.map((reason) => (
              <p key={reason} class="rejected">
                {reason}
              </p>
            ))}
          </li>
        ))}
      </ol>
    </section>
  );
}

/** The few things that must be said, and the button. */
function Fit({ live, session, state, busy }: Props & { busy: boolean }) {
  const { kind, shots, measured } = state;
  const [stops, setStops] = useState("");
  const [chart, setChart] = useState("");
  const [reflectance, setReflectance] = useState("");
  const [inner, setInner] = useState("");
  const [outer, setOuter] = useState("");
  const [focal, setFocal] = useState("");
  const given = (text: string) => (text.trim() === "" ? null : Number(text));
  const order = () => {
    switch (kind) {
      case "noise":
        return { stops: given(stops) };
      case "colour":
        return { chart: chart === "" ? null : chart };
      case "flash":
        return {
          target_reflectance: given(reflectance),
          ring_radii: [Number(inner) / 1000, Number(outer) / 1000],
          focal_px: given(focal),
        };
      default:
        return {};
    }
  };
  return (
    <form
      onSubmit={(event) => {
        event.preventDefault();
        void live.attempt(calibrations.fit(session, kind, order()));
      }}
    >
      {kind === "noise" && <Field label={words.stops} value={stops} least={0.01} most={10} onChange={setStops} free />}
      {kind === "colour" && (
        <label>
          {words.chart}
          <select value={chart} onChange={(event) => setChart(event.currentTarget.value)}>
            <option value="">{words.anyChart}</option>
            {Object.entries(words.charts).map(([name, label]) => (
              <option key={name} value={name}>
                {label}
              </option>
            ))}
          </select>
        </label>
      )}
      {kind === "flash" && (
        <>
          <Field label={words.reflectance} value={reflectance} least={0.01} most={1} onChange={setReflectance} free />
          <Field label={words.innerRadius} value={inner} least={0} most={999} onChange={setInner} />
          <Field label={words.outerRadius} value={outer} least={0.1} most={999} onChange={setOuter} />
          <Field label={words.focal} value={focal} least={1} most={1e6} onChange={setFocal} free />
        </>
      )}
      <button type="submit" disabled={busy || shots.length === 0}>
        {measured ? words.fitAgain : words.fit}
      </button>
    </form>
  );
}

/** What was measured: verdict, figure, figures, files. */
function Result({ live, session, state }: Props) {
  const { kind, guide, measured, unreadable } = state;
  const [record, setRecord] = useState<CalibrationRecord | null>(null);
  const when = measured?.measured ?? null;
  useEffect(() => {
    setRecord(null);
    if (when === null) return;
    const end = new AbortController();
    void live.attempt(calibrations.record(session, kind, end.signal).then(setRecord, (error: unknown) => {
      if (!end.signal.aborted) throw error;
    }));
    return () => end.abort();
  }, [session, kind, when]);
  const picture = measured?.files.find((file) => file.name.endsWith(".svg"));
  return (
    <div class="result" aria-live="polite">
      {unreadable && <p class="rejected">{unreadable}</p>}
      {measured && (
        <>
          <h3>{words.result}</h3>
          {measured.sentences.map((sentence, i) => (
            <p key={sentence} class={i > 0 ? undefined : measured.good ? "accepted" : "rejected"}>
              {sentence}
            </p>
          ))}
          {picture && (
            // Its address stays the same from one measurement to the next.
            <img key={measured.measured} src={`${picture.url}?of=${encodeURIComponent(measured.measured)}`} alt={words.figure(guide.title)} />
          )}
          {record && (
            <dl>
              {keyFigures(kind, record).map(([name, value]) => (
                <div key={name}>
                  <dt>{name}</dt>
                  <dd>{value}</dd>
                </div>
              ))}
            </dl>
          )}
          <p class="dim">
            {words.measuredFrom(measured.measured, measured.shots)} {measured.validity.words}
          </p>
          <p class="results">
            {measured.files.map((file) => (
              <a key={file.name} href={file.url} target="_blank" rel="noopener">
                {words.files[file.name.split(".").pop() ?? ""] ?? file.name}
              </a>
            ))}
          </p>
        </>
      )}
    </div>
  );
}

function Field(props: {
  label: string;
  value: string;
  least: number;
  most: number;
  /** May be left empty. */
  free?: boolean;
  onChange: (value: string) => void;
}) {
  return (
    <label>
      {props.label}
      <input
        type="number"
        inputMode="decimal"
        required={!props.free}
        min={props.least}
        max={props.most}
        step="any"
        value={props.value}
        onInput={(event) => props.onChange(event.currentTarget.value)}
      />
    </label>
  );
}
