import { useEffect, useState } from "preact/hooks";
import { api, type FlashAccount, type Pulse } from "./api";
import type { Live } from "./live";
import { words } from "./words";

/** What the session's pairs tell of the flash: proof, energies, advice. */
export function Flash({ live }: { live: Live }) {
  const session = live.session;
  const newest = live.pairs[0]?.number ?? 0;
  const [account, setAccount] = useState<FlashAccount | null>(null);
  const [problem, setProblem] = useState<string | null>(null);
  const runs = live.jobs.filter((job) => job.kind === "repeatability" && job.state === "done").length;
  const about = session ? [session.name, newest, session.has_flash_calibration, runs].join("\n") : null;
  useEffect(() => {
    if (!session) return;
    const end = new AbortController();
    api.flash(session.name, end.signal).then(
      (told) => {
        setAccount(told);
        setProblem(null);
      },
      (error: unknown) => {
        if (!end.signal.aborted) setProblem(error instanceof Error ? error.message : String(error));
      },
    );
    return () => end.abort();
  }, [about]);

  if (!session || (newest === 0 && !account?.repeatability)) return null;
  return (
    <section class="flash" aria-labelledby="flash-light">
      <div class="head">
        <h2 id="flash-light">{words.flashLight}</h2>
      </div>
      {problem && <p class="rejected">{problem}</p>}
      {account && (
        <>
          {account.advice.length > 0 && (
            <ul class="advice" aria-live="polite">
              {account.advice.map((advice) => (
                <li key={advice.code}>{advice.sentence}</li>
              ))}
            </ul>
          )}
          {account.pulses.length > 1 && <Energies pulses={account.pulses} />}
          {newest > 0 && <p class="dim">{account.words}</p>}
          {account.repeatability && <p class="dim">{words.repeatability(account.repeatability)}</p>}
        </>
      )}
    </section>
  );
}

const WIDTH = 280;
const HEIGHT = 72;
const EDGE = 6;

/** Energy of the pulses, pair by pair, with the standard deviation of each reading. */
function Energies({ pulses }: { pulses: Pulse[] }) {
  const first = pulses[0]!.pair;
  const span = Math.max(pulses[pulses.length - 1]!.pair - first, 1);
  const gains = pulses.map((pulse) => pulse.gain);
  const mean = gains.reduce((sum, gain) => sum + gain, 0) / gains.length;
  // At least 1 % each way, so that a steady flash looks steady.
  const reach = Math.max(0.01, ...pulses.map((p) => Math.abs(p.gain / mean - 1) + p.deviation / mean));
  const x = (pair: number) => EDGE + ((pair - first) / span) * (WIDTH - 2 * EDGE);
  const y = (gain: number) => HEIGHT / 2 - ((gain / mean - 1) / reach) * (HEIGHT / 2 - EDGE);
  return (
    <div class="energies">
      <svg viewBox={`0 0 ${WIDTH} ${HEIGHT}`} role="img" aria-label={words.energies(pulses.length, reach)}>
        <line class="mean" x1="0" x2={WIDTH} y1={HEIGHT / 2} y2={HEIGHT / 2} />
        {pulses.map((pulse) => (
          <g key={pulse.pair}>
            <title>{words.energy(pulse)}</title>
            <line
              x1={x(pulse.pair)}
              x2={x(pulse.pair)}
              y1={y(pulse.gain - pulse.deviation)}
              y2={y(pulse.gain + pulse.deviation)}
            />
            <circle cx={x(pulse.pair)} cy={y(pulse.gain)} r="2.6" />
          </g>
        ))}
      </svg>
      <p class="dim">{words.energyScale(reach)}</p>
    </div>
  );
}
