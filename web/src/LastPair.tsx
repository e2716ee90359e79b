import { useEffect, useState } from "preact/hooks";
import { api, type FrameFigures, type Pair } from "./api";
import { Histogram, type Scale } from "./Histogram";
import type { Live } from "./live";
import { words } from "./words";

const SCALES: Scale[] = ["logarithmic", "linear"];

/** The newest pair: verdict and raw histograms of both frames. */
export function LastPair({ live }: { live: Live }) {
  const [scale, setScale] = useState<Scale>("logarithmic");
  const pair = live.pairs[0];
  const session = live.session;
  if (!pair || !session) return null;
  return (
    <section class="last" aria-labelledby="last">
      <div class="head">
        <h2 id="last">
          {words.lastPair(pair.number)}{" "}
          <span class={pair.verdict}>{pair.verdict === "accepted" ? words.accepted : words.rejected}</span>
        </h2>
        <div class="switch" role="group" aria-label={words.scale}>
          {SCALES.map((name) => (
            <button key={name} type="button" aria-pressed={scale === name} onClick={() => setScale(name)}>
              {words.scales[name]}
            </button>
          ))}
        </div>
      </div>
      {pair.flash && <p class="dim">{pair.flash.words}</p>}
      <Histograms session={session.name} pair={pair} scale={scale} region={JSON.stringify(session.region ?? null)} />
    </section>
  );
}

interface Wanted {
  session: string;
  pair: Pair;
  scale: Scale;
  /** The region in which the server measures, written out: another region gives other figures. */
  region: string;
}

function Histograms({ session, pair, scale, region }: Wanted) {
  const [frames, setFrames] = useState<{ about: string; off: FrameFigures; on: FrameFigures } | null>(null);
  const [problem, setProblem] = useState<string | null>(null);
  const about = [session, pair.number, region].join("\n");
  useEffect(() => {
    const end = new AbortController();
    const load = async () => {
      try {
        // One after the other: decoding shares the machine with the checks of the next pair.
        const on = await api.histogram(session, pair.number, "on", end.signal);
        const off = await api.histogram(session, pair.number, "off", end.signal);
        if (end.signal.aborted) return;
        setFrames({ about, off, on });
      } catch (error) {
        if (end.signal.aborted) return;
        setProblem(error instanceof Error ? error.message : String(error));
      }
    };
    setProblem(null);
    void load();
    return () => end.abort();
  }, [about]);

  if (problem) return <p class="dim">{problem}</p>;
  if (!frames) return <p class="dim">{words.histogramsWait}</p>;
  const inRegion = region !== "null";
  // Figures of the pair before keep the place, but are not to be taken for those of this one.
  return (
    <div class={frames.about === about ? "histograms" : "histograms old"}>
      <Histogram figures={frames.off} scale={scale} label={words.off} inRegion={inRegion} />
      <Histogram figures={frames.on} scale={scale} label={words.on} inRegion={inRegion} />
    </div>
  );
}
