import { useEffect, useState } from "preact/hooks";
import { type Calibration, type CalibrationRecord, calibrations } from "./calibration";
import { Drawing } from "./CalibrationDrawing";
import { Fit } from "./CalibrationFit";
import { Shots } from "./CalibrationShots";
import { TakeOne } from "./CalibrationTake";
import { calibrationWords as words, keyFigures } from "./calibrationWords";
import { Field } from "./Field";
import { JobLine } from "./Jobs";
import type { Live } from "./live";

export interface Props {
  live: Live;
  session: string;
  state: Calibration;
}

/** One calibration from set-up to verdict. */
export function Guide({ live, session, state }: Props) {
  const { kind, guide } = state;
  const [distance, setDistance] = useState("");
  const [heldOut, setHeldOut] = useState<string[]>([]);
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
      <Shots live={live} session={session} state={state} heldOut={heldOut} onHeldOut={setHeldOut} />
      <Lacks state={state} />
      <Fit
        live={live}
        session={session}
        state={state}
        heldOut={heldOut.filter((id) => state.shots.some((shot) => shot.id === id))}
        busy={running.some((job) => job.kind === about[0])}
      />
      <Result live={live} session={session} state={state} />
      <details class="terminal">
        <summary class="dim">{words.terminal}</summary>
        <code>{guide.command}</code>
      </details>
    </div>
  );
}

/** What is still missing for a measurement. */
function Lacks({ state }: { state: Calibration }) {
  if (state.lacks.length === 0) return <p class="accepted">{words.complete}</p>;
  // What was measured needs nothing more.
  if (state.measured && state.shots.length === 0) return null;
  return (
    <section class="lacks" aria-label={words.lacks} aria-live="polite">
      <h3>{words.lacks}</h3>
      <ul>
        {state.lacks.map((lack) => (
          <li key={lack}>{lack}</li>
        ))}
      </ul>
    </section>
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
