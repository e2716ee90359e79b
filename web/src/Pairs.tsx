import type { Frame, Pair } from "./api";
import type { Live } from "./live";
import { Reasons } from "./Reasons";
import { counted, words } from "./words";

/** With room for fewer pairs the disk should be looked after. */
const FEW = 20;

export function Pairs({ live }: { live: Live }) {
  const rejected = live.pairs.filter((pair) => pair.verdict === "rejected").length;
  const good = live.pairs.length - rejected;
  const room = live.session?.room?.pairs;
  const mirror = live.session?.mirror;
  return (
    <section class="pairs" aria-labelledby="pairs">
      <div class="head">
        <h2 id="pairs">{words.pairs}</h2>
        {live.pairs.length > 0 && (
          <span class="dim">
            {counted(good, "good", "good")}
            {rejected > 0 && `, ${rejected} rejected`}
            {room != null && <span class={room < FEW ? "scarce" : undefined}>, {words.room(room)}</span>}
          </span>
        )}
        {mirror?.state === "behind" && <span class="dim">{mirror.words}</span>}
        {mirror?.state === "failing" && <span class="scarce">{words.noCopy}</span>}
      </div>
      {live.pairs.length === 0 ? (
        <p class="dim">{words.noPairs}</p>
      ) : (
        <ol>
          {live.pairs.map((pair) => (
            <PairCard key={pair.number} pair={pair} />
          ))}
        </ol>
      )}
    </section>
  );
}

function PairCard({ pair }: { pair: Pair }) {
  return (
    <li class={pair.verdict} data-pair={pair.number}>
      <div class="frames">
        <Thumb pair={pair} frame={pair.off} label={words.off} />
        <Thumb pair={pair} frame={pair.on} label={words.on} />
      </div>
      <div class="head">
        <h3>{pair.number}</h3>
        <span class="verdict">{pair.verdict === "accepted" ? words.accepted : words.rejected}</span>
      </div>
      <Reasons reasons={pair.reasons} />
      {pair.on.settings && <p class="dim">{pair.on.settings}</p>}
    </li>
  );
}

function Thumb({ pair, frame, label }: { pair: Pair; frame: Frame; label: string }) {
  return (
    <a href={frame.url} download title={frame.file}>
      <figure>
        <img src={frame.thumbnail} alt={`Pair ${pair.number}, ${label.toLowerCase()}`} loading="lazy" />
        <figcaption>{label}</figcaption>
      </figure>
    </a>
  );
}
