import { useEffect, useState } from "preact/hooks";
import { api, type Camera, type FoundExposure, type Session } from "./api";
import { sameExposure, useCamera } from "./camera";
import { type Chosen, complete, Dials, onDials } from "./Dials";
import { JobLine } from "./Jobs";
import type { Live } from "./live";
import { Lock } from "./Lock";
import { words } from "./words";

export function Exposure({ live }: { live: Live }) {
  const { camera, problem, asking, askAgain } = useCamera(live);
  const session = live.session;
  return (
    <section class="exposure" aria-labelledby="exposure">
      <div class="head">
        <h2 id="exposure">{words.exposure}</h2>
        {(camera || problem) && (
          <button type="button" class="quiet" disabled={asking || live.rigJob !== null} onClick={askAgain}>
            {asking ? words.looking : words.checkAgain}
          </button>
        )}
      </div>
      {problem ? (
        <p class="rejected">{problem}</p>
      ) : (
        !camera && <p class="dim">{asking ? words.looking : words.exposureWaits}</p>
      )}
      {camera && (
        <>
          <Standing camera={camera} session={session} />
          <Lock live={live} items={camera.lock} />
          {session ? (
            <Plan key={session.name} live={live} camera={camera} session={session} />
          ) : (
            <p class="dim">{words.exposureNeedsSession}</p>
          )}
        </>
      )}
      {session && <Finding live={live} session={session} />}
    </section>
  );
}

/** At what the session is locked, and whether the camera stands there. */
function Standing({ camera, session }: { camera: Camera; session: Session | null }) {
  const plan = session?.exposure ?? null;
  const found = camera.exposure ?? null;
  const agrees = plan && found && (sameExposure(found, plan.on) || sameExposure(found, plan.off));
  return (
    <div class="standing" aria-live="polite">
      {plan && <p>{words.lockedAt(plan.words)}</p>}
      {!found ? (
        <p class="dim">{words.cameraTellsNoExposure}</p>
      ) : !plan ? (
        <p>{words.notLocked(found)}</p>
      ) : (
        !agrees && <p class="dim">{words.setWithNextPair(found)}</p>
      )}
    </div>
  );
}

interface Draft {
  on: Chosen;
  /** Null: as with flash. */
  off: Chosen | null;
}

function Plan({ live, camera, session }: { live: Live; camera: Camera; session: Session }) {
  const plan = session.exposure ?? null;
  const [draft, setDraft] = useState<Draft | null>(null);
  const [sending, setSending] = useState(false);
  useEffect(() => setDraft(null), [plan?.words]);

  const { offered } = camera;
  const shown: Draft = draft ?? {
    on: onDials(plan?.on ?? camera.exposure ?? null, offered),
    off: plan && !sameExposure(plan.off, plan.on) ? onDials(plan.off, offered) : null,
  };
  const on = complete(shown.on);
  const off = shown.off && complete(shown.off);
  const whole = on !== null && (shown.off === null || off !== null);
  const changes = !plan || (whole && !(sameExposure(on, plan.on) && sameExposure(off ?? on, plan.off)));
  const rigBusy = live.rigJob !== null;

  const set = async () => {
    if (!on) return;
    setSending(true);
    const kept = await live.attempt(api.setExposure(session.name, on, off));
    if (kept) setDraft(null);
    setSending(false);
  };
  return (
    <form
      onSubmit={(event) => {
        event.preventDefault();
        void set();
      }}
    >
      <Dials
        legend={shown.off ? words.withFlash : words.bothFrames}
        quiet={!shown.off}
        offered={offered}
        chosen={shown.on}
        onChange={(chosen) => setDraft({ ...shown, on: chosen })}
      />
      <label class="check">
        <input
          type="checkbox"
          checked={shown.off !== null}
          onChange={(event) => setDraft({ ...shown, off: event.currentTarget.checked ? shown.on : null })}
        />
        {words.separateOff}
      </label>
      {shown.off && (
        <Dials
          legend={words.withoutFlash}
          quiet={false}
          offered={offered}
          chosen={shown.off}
          onChange={(chosen) => setDraft({ ...shown, off: chosen })}
        />
      )}
      <div class="actions">
        <button type="submit" disabled={!whole || !changes || sending || rigBusy}>
          {words.set}
        </button>
        <button
          type="button"
          disabled={rigBusy}
          onClick={() => void live.attempt(api.findExposure(session.name, shown.off !== null))}
        >
          {words.findExposure}
        </button>
      </div>
      <p class="dim">{session.region ? words.findInRegion : words.findInFrame}</p>
    </form>
  );
}

/** The newest search for an exposure in this session: how far it is, or what it found. */
function Finding({ live, session }: { live: Live; session: Session }) {
  const job = live.jobs.find((j) => j.kind === "find_exposure" && j.session === session.name);
  if (!job) return null;
  if (job.state !== "done") {
    return (
      <ul class="jobs" aria-live="polite">
        <JobLine job={job} live={live} />
      </ul>
    );
  }
  const found = job.result as FoundExposure | null | undefined;
  if (!found) return null;
  const { on, off } = found.exposure;
  const used = session.exposure && sameExposure(session.exposure.on, on) && sameExposure(session.exposure.off, off);
  return (
    <div class="found" aria-live="polite">
      <p>{words.found(found)}</p>
      {found.warnings.map((warning) => (
        <p key={warning} class="warns">
          {warning}
        </p>
      ))}
      {!used && (
        <button
          type="button"
          disabled={live.rigJob !== null}
          onClick={() =>
            void live.attempt(api.setExposure(session.name, on, sameExposure(on, off) ? null : off))
          }
        >
          {words.useFound}
        </button>
      )}
    </div>
  );
}
