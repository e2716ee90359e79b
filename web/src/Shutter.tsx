import { useEffect, useRef } from "preact/hooks";
import { api } from "./api";
import type { Live } from "./live";
import { LiveView } from "./LiveView";
import { Reasons } from "./Reasons";
import { SequenceGuide } from "./Sequence";
import { currentSequence, stepOf } from "./sequence";
import { words } from "./words";

/** Fields and buttons that have their own use for the space bar. */
const BUSY_WITH_SPACE = "input, textarea, select, button, a, summary, [contenteditable]";

export function Shutter({ live }: { live: Live }) {
  const job = live.jobs.find((j) => j.kind === "pair" && (j.state === "running" || j.state === "queued"));
  const prompt = live.state?.prompt ?? null;
  const step = stepOf(currentSequence(live));
  const asked = useRef(false);

  const take = async () => {
    if (asked.current || job) return;
    asked.current = true;
    if (step) await (step.act && live.attempt(step.act()));
    else await live.attempt(api.takePair());
    asked.current = false;
  };
  const confirm = () => live.attempt(api.confirm());

  const act = useRef<() => void>(() => {});
  act.current = prompt === null ? () => void take() : () => void confirm();
  useEffect(() => {
    const pressed = (event: KeyboardEvent) => {
      if (event.code !== "Space" || event.repeat || event.ctrlKey || event.metaKey || event.altKey) return;
      const target = event.target instanceof Element ? event.target.closest(BUSY_WITH_SPACE) : null;
      if (target && !target.matches(".shutter button.big")) return;
      event.preventDefault();
      act.current();
    };
    // The big button's own click on release of the space bar would take a second pair.
    const released = (event: KeyboardEvent) => {
      if (event.code === "Space" && event.target instanceof Element && event.target.matches(".shutter button.big")) {
        event.preventDefault();
      }
    };
    // A button clicked by hand keeps the focus, and the next press of the space bar would click it again.
    const clicked = (event: MouseEvent) => {
      if (event.detail > 0 && event.target instanceof Element) event.target.closest("button")?.blur();
    };
    window.addEventListener("click", clicked);
    window.addEventListener("keydown", pressed);
    window.addEventListener("keyup", released);
    return () => {
      window.removeEventListener("click", clicked);
      window.removeEventListener("keydown", pressed);
      window.removeEventListener("keyup", released);
    };
  }, []);

  const last = live.pairs[0];
  return (
    <section class="shutter" aria-label={words.take}>
      <LiveView live={live} />
      <SequenceGuide live={live} />
      {prompt === null ? (
        <button type="button" class="big" aria-disabled={job !== undefined || step?.act === null} onClick={() => void take()}>
          <span class="ring" aria-hidden="true" />
          <span>
            {job ? words.taking : (step?.label ?? words.take)}
            {!job && <small class="keys">{words.space}</small>}
          </span>
        </button>
      ) : (
        <button type="button" class="big asks" onClick={() => void confirm()}>
          <span>
            {prompt}
            <small>
              {words.confirm}, {words.space}
            </small>
          </span>
        </button>
      )}
      <div class="now" aria-live="polite">
        {job ? (
          <>
            <Steps done={job.done} total={job.total} />
            <p>{job.stage || words.taking}</p>
            {live.recovery && <p class="recovery">{live.recovery}</p>}
          </>
        ) : live.recovery ? (
          <p class="recovery">{live.recovery}</p>
        ) : last ? (
          <>
            <p class={last.verdict}>
              {last.verdict === "accepted" ? words.afterAccepted(last.number) : words.afterRejected(last.number)}
            </p>
            <Reasons reasons={last.reasons} />
          </>
        ) : (
          <p class="dim">{words.idle}</p>
        )}
      </div>
      <button
        type="button"
        class="quiet"
        style={{ visibility: job ? "visible" : "hidden" }}
        onClick={() => void (job && live.attempt(api.cancel(job.id)))}
      >
        {words.cancel}
      </button>
    </section>
  );
}

function Steps({ done, total }: { done: number; total: number }) {
  const steps = Array.from({ length: total || 6 }, (_, i) => i);
  return (
    <div class="steps" aria-hidden="true">
      {steps.map((i) => (
        <span key={i} class={i < done ? "past" : i === done ? "present" : ""} />
      ))}
    </div>
  );
}
