import type { Camera, Exposure } from "./api";
import { words } from "./words";

/** As chosen so far; null where nothing is. */
export type Chosen = { [dial in keyof Exposure]: number | null };

type Offered = Camera["offered"];

const DIALS = ["shutter_s", "aperture", "iso"] as const;

const OFFERED: Record<keyof Exposure, keyof Offered> = {
  shutter_s: "shutters_s",
  aperture: "apertures",
  iso: "isos",
};

/** The places of the dials that are meant by an exposure's labels. */
export function onDials(exposure: Exposure | null, offered: Offered): Chosen {
  const place = (dial: keyof Exposure) =>
    exposure &&
    offered[OFFERED[dial]].reduce<number | null>((best, value) => {
      const far = (v: number) => Math.abs(Math.log2(v / exposure[dial]));
      return best === null || far(value) < far(best) ? value : best;
    }, null);
  return { shutter_s: place("shutter_s"), aperture: place("aperture"), iso: place("iso") };
}

export function complete(chosen: Chosen): Exposure | null {
  const { shutter_s, aperture, iso } = chosen;
  return shutter_s === null || aperture === null || iso === null ? null : { shutter_s, aperture, iso };
}

interface Props {
  legend: string;
  /** Whether the legend is to be read only, not seen. */
  quiet: boolean;
  offered: Offered;
  chosen: Chosen;
  onChange: (chosen: Chosen) => void;
}

/** Shutter, aperture and ISO, each chosen from what the camera offers. */
export function Dials({ legend, quiet, offered, chosen, onChange }: Props) {
  return (
    <fieldset class="dials">
      <legend class={quiet ? "unseen" : "dim"}>{legend}</legend>
      {DIALS.map((dial) => (
        <label key={dial}>
          <span class="dim">{words.dials[dial]}</span>
          <select
            value={chosen[dial] ?? ""}
            onChange={(event) => onChange({ ...chosen, [dial]: Number(event.currentTarget.value) })}
          >
            {chosen[dial] === null && <option value="">{words.unknown}</option>}
            {offered[OFFERED[dial]].map((value) => (
              <option key={value} value={value}>
                {words.labels[dial](value)}
              </option>
            ))}
          </select>
        </label>
      ))}
    </fieldset>
  );
}
