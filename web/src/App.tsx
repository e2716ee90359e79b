import { Calibration } from "./Calibration";
import { Devices } from "./Devices";
import { Exposure } from "./Exposure";
import { Flash } from "./Flash";
import { Jobs } from "./Jobs";
import { LastPair } from "./LastPair";
import { useLive } from "./live";
import { Pairs } from "./Pairs";
import { Sequence } from "./Sequence";
import { SessionMenu } from "./SessionMenu";
import { Shutter } from "./Shutter";
import { words } from "./words";

export function App() {
  const live = useLive();
  const studio = live.state?.studio ?? null;
  const mirror = live.session?.mirror;
  return (
    <>
      <header>
        <a class="mark" href="/" aria-label="unlit">
          <img src="/assets/icon.svg" alt="" width="28" height="28" />
          unlit
        </a>
        <SessionMenu live={live} />
        {studio && (
          <p class="studio">
            <strong>{words.studio}</strong>
            <span>{studio.words}</span>
          </p>
        )}
      </header>
      <div class="notices" aria-live="assertive">
        {!live.connected && <p class="notice lost">{words.lost}</p>}
        {mirror?.state === "failing" && (
          <p class="notice mirror" role="alert">
            {mirror.words}
          </p>
        )}
        {live.troubles.length > 0 && (
          <div class="notice trouble" role="alert">
            <div>
              {live.troubles.map((trouble) => (
                <p key={trouble}>{trouble}</p>
              ))}
            </div>
            <button type="button" class="quiet" onClick={live.dismiss}>
              {words.dismiss}
            </button>
          </div>
        )}
      </div>
      <main>
        <div class="work">
          <Shutter live={live} />
          <Sequence live={live} />
          <LastPair live={live} />
        </div>
        <aside>
          <Devices live={live} />
          <Flash live={live} />
          <Exposure live={live} />
          <Jobs live={live} />
        </aside>
        <Calibration live={live} />
        <Pairs live={live} />
      </main>
    </>
  );
}
