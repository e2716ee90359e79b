import { api, type Job } from "./api";
import type { Live } from "./live";
import { jobState, jobTitle, words } from "./words";

/** Kinds that are shown where they are asked for. */
const ELSEWHERE = ["pair", "develop", "find_exposure", "calibration_shot"];

export function Jobs({ live }: { live: Live }) {
  const session = live.session;
  const jobs = live.jobs.filter((job) => !ELSEWHERE.includes(job.kind));
  const running = jobs.filter((job) => job.state === "running" || job.state === "queued");
  const last = jobs.find((job) => job.state !== "queued" && job.state !== "running");
  const shown = last && !running.some((job) => job.id < last.id) ? [...running, last] : running;
  const missing = session
    ? [
        !session.has_scene && words.scene,
        !session.has_flash_calibration && words.calibration,
        session.accepted === 0 && words.pairMissing,
      ].filter((word) => word !== false)
    : [];
  return (
    <section aria-labelledby="jobs">
      <div class="head">
        <h2 id="jobs">{words.processing}</h2>
        {session && missing.length === 0 && running.length === 0 && (
          <button type="button" class="quiet" onClick={() => void live.attempt(api.process(session.name))}>
            {words.again}
          </button>
        )}
      </div>
      {missing.length > 0 && (
        <p class="dim">{words.waitsFor(missing.join(", ").replace(/, ([^,]*)$/, `${words.and}$1`))}</p>
      )}
      {session && missing.length === 0 && shown.length === 0 && <p class="dim">{words.nothingRuns}</p>}
      {!session && <p class="dim">{words.noPairs}</p>}
      <ul class="jobs" aria-live="polite">
        {shown.map((job) => (
          <JobLine key={job.id} job={job} live={live} />
        ))}
      </ul>
      {session && session.results.length > 0 && (
        <p class="results">
          {session.results.map((result) => (
            <a key={result.name} href={result.url} target="_blank" rel="noopener">
              {result.name}
            </a>
          ))}
        </p>
      )}
    </section>
  );
}

export function JobLine({ job, live }: { job: Job; live: Live }) {
  const active = job.state === "running" || job.state === "queued";
  return (
    <li class={job.state}>
      <div class="head">
        <span>{jobTitle(job)}</span>
        {active ? (
          <button type="button" class="quiet" onClick={() => void live.attempt(api.cancel(job.id))}>
            {words.cancel}
          </button>
        ) : (
          <span class="dim">{jobState(job)}</span>
        )}
      </div>
      {job.state === "running" && (
        <progress
          aria-label={jobTitle(job)}
          {...(job.total > 0 ? { value: job.done, max: job.total } : {})}
        />
      )}
      {active && <span class="dim">{job.stage || jobState(job)}</span>}
      {job.problem && <p class="rejected">{job.problem.words}</p>}
    </li>
  );
}
