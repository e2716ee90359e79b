import type { ColourFigures, FrameFigures } from "./api";
import { words } from "./words";

export type Scale = "logarithmic" | "linear";

// The drawing's own units. The bars right of the plot are the pixels at saturation.
const WIDTH = 300;
const HEIGHT = 110;
const BAR = 5;
const SIDE = 4 + 3 * (BAR + 1);

interface Props {
  figures: FrameFigures;
  scale: Scale;
  label: string;
  /** Whether the figures are those of a region and not of the whole frame. */
  inRegion: boolean;
}

/** Sensor values of a frame, black at the left edge and saturation at the marked line, and what is clipped. */
export function Histogram({ figures, scale, label, inRegion }: Props) {
  const { colours } = figures;
  const size = (count: number) => (scale === "linear" ? count : Math.log1p(count));
  const highest = Math.max(1, ...colours.flatMap((c) => [...c.bins, c.at_saturation].map(size)));
  const tall = (count: number) => (size(count) / highest) * HEIGHT;
  return (
    <div class="histogram">
      <h4>{label}</h4>
      <svg viewBox={`0 -4 ${WIDTH + SIDE} ${HEIGHT + 5}`} role="img" aria-label={words.histogram(label, scale)}>
        <line class="ground" x1="0" x2={WIDTH + SIDE} y1={HEIGHT} y2={HEIGHT} />
        {colours.map((colour) => (
          <path key={colour.colour} class={colour.colour} d={outline(colour.bins, tall)} />
        ))}
        <line class="saturation" x1={WIDTH} x2={WIDTH} y1="-4" y2={HEIGHT} />
        {colours.map((colour, i) => (
          <rect
            key={colour.colour}
            class={colour.colour}
            x={WIDTH + 4 + i * (BAR + 1)}
            y={HEIGHT - tall(colour.at_saturation)}
            width={BAR}
            height={tall(colour.at_saturation)}
          />
        ))}
      </svg>
      <p class="ends dim" aria-hidden="true">
        <span>{words.black}</span>
        <span>{words.saturation}</span>
      </p>
      <table>
        <thead>
          <tr>
            <td />
            <th scope="col">{words.brightest}</th>
            <th scope="col">{inRegion ? words.clippedInRegion : words.clipped}</th>
            {inRegion && <th scope="col">{words.clippedInFrame}</th>}
          </tr>
        </thead>
        <tbody>
          {colours.map((colour) => (
            <tr key={colour.colour}>
              <th scope="row">
                <span class={`swatch ${colour.colour}`} aria-hidden="true" />
                {words.colours[colour.colour]}
              </th>
              <td>{brightest(colour)}</td>
              <td class={colour.clipped_share > 0 ? "some" : ""}>{words.share(colour.clipped_share)}</td>
              {inRegion && <td>{words.share(colour.frame_clipped_share)}</td>}
            </tr>
          ))}
        </tbody>
      </table>
    </div>
  );
}

/** The bins as a closed outline of steps. */
function outline(bins: number[], tall: (count: number) => number): string {
  const wide = WIDTH / bins.length;
  const steps = bins.map((count, i) => {
    const y = (HEIGHT - tall(count)).toFixed(1);
    return `L${(i * wide).toFixed(1)} ${y}L${((i + 1) * wide).toFixed(1)} ${y}`;
  });
  return `M0 ${HEIGHT}${steps.join("")}L${WIDTH} ${HEIGHT}Z`;
}

/** The largest value on the way from black to saturation. */
function brightest({ maximum_dn, from_dn, to_dn }: ColourFigures): string {
  return maximum_dn == null ? words.unknown : words.level(Math.max(0, maximum_dn - from_dn) / (to_dn - from_dn));
}
