// What the page says by itself about calibrations; what to do and the verdicts are the server's own sentences.

import type { CalibrationRecord, Kind } from "./calibration";
import { counted } from "./words";

const percent = (share: number, digits: number) => `${(100 * share).toFixed(digits)} %`;
const fixed = (value: number, digits: number) => value.toFixed(digits);

export const calibrationWords = {
  calibrate: "Calibrate",
  needsSession: "To calibrate, make a session first (above) or take the first pair.",
  state: (measured: number, all: number) => `${measured} of ${all} measured`,
  states: { good: "measured", bad: "measured, not good", none: "not measured", waiting: "in progress" },
  drawings: {
    levels: "The camera with its lens cap on, and before a bright, even surface",
    noise: "The camera on a tripod before an evenly lit plain surface",
    exposure: "The camera on a tripod before a lit card, one dial turned",
    flat: "The camera turned by 90 degrees before an evenly lit surface",
    flash: "The camera with the ring flash before a white card at a measured distance",
    colour: "The camera with the flash before a colour chart that lies flat",
  } satisfies Record<Kind, string>,
  shoot: "Take one",
  shootCard: "Take card shot",
  send: "Or send raw files",
  sendCards: "Or send frames lit in a dark room, all at this distance",
  sending: "Sending…",
  distance: "Distance from lens to card, metres",
  shots: "Shots for the next measurement",
  noShots: "No shots yet.",
  shot: (name: string, exposure: string) => (exposure === "" ? name : `${name}: ${exposure}`),
  metres: (distance: number) => `${distance} m`,
  mean: (share: number) => `mean ${percent(share, share < 0.1 ? 1 : 0)}`,
  clipped: (share: number) => `, ${percent(share, share < 0.01 ? 2 : 0)} clipped`,
  used: "in use",
  remove: "Remove",
  removeShot: (n: number, name: string) => `Remove shot ${n}, ${name}`,
  fit: "Measure",
  fitAgain: "Measure again",
  stops: "Stops of light from level to level, if the light was changed",
  chart: "Chart",
  anyChart: "whichever fits best",
  charts: {
    colorchecker24: "ColorChecker 24, November 2014 or later",
    colorchecker24_before2014: "ColorChecker 24, before November 2014",
    spydercheckr24: "SpyderCHECKR 24",
  },
  reflectance: "Reflectance of the card (empty: office paper, 0.94)",
  innerRadius: "Inner radius of the ring, millimetres",
  outerRadius: "Outer radius of the ring, millimetres",
  focal: "Focal length in pixels (empty: from the scene)",
  result: "Result",
  measuredFrom: (when: string, shots: number) =>
    `Measured ${new Date(when).toLocaleString()} from ${counted(shots, "shot", "shots")}.`,
  figure: (title: string) => `Figure: ${title}`,
  files: { json: "Record", svg: "Figure", png: "Picture of the patches", html: "Report" } as Record<string, string>,
  terminal: "The same from files, in a terminal",
};

/** The figures of a record that matter most, with their names; none where it has others than are known here. */
export function keyFigures(kind: Kind, record: CalibrationRecord): [string, string][] {
  const figures: [string, string][] = [];
  const put = (name: string, value: unknown, show: (value: number) => string) => {
    if (typeof value === "number" && Number.isFinite(value)) figures.push([name, show(value)]);
  };
  switch (kind) {
    case "levels":
      for (const level of record.levels ?? []) {
        for (const site of level.sites ?? []) {
          const name = `ISO ${level.iso}, ${site.colour} ${site.row}${site.column}`;
          put(`${name}: black`, site.black_dn, (v) => `${fixed(v, 2)} DN`);
          put(`${name}: saturation`, site.saturation_dn, (v) => `${fixed(v, 0)} DN`);
        }
      }
      break;
    case "noise":
      for (const noise of record.noise ?? []) {
        put(`ISO ${noise.iso}: electrons per DN`, noise.electrons_per_dn, (v) => fixed(v, 3));
        put(`ISO ${noise.iso}: read noise`, noise.read_noise_e, (v) => `${fixed(v, 2)} e`);
      }
      break;
    case "exposure":
      for (const ladder of record.ladders ?? []) {
        put(`${ladder.setting}: steps`, ladder.steps?.length, (v) => fixed(v, 0));
        put(`${ladder.setting}: largest deviation`, ladder.summary?.max, (v) => percent(v, 2));
      }
      break;
    case "flat":
      for (const [i, colour] of ["red", "green", "blue"].entries()) {
        put(`${colour}: corner against centre`, record.corner?.[i], (v) => percent(v, 2));
      }
      break;
    case "flash":
      for (const [i, colour] of ["red", "green", "blue"].entries()) {
        put(`${colour}: radiance`, record.radiance_dn?.[i], (v) => `${fixed(v, 0)} DN`);
      }
      put("residual", record.residual_rms, (v) => percent(v, 2));
      break;
    case "colour":
      put("CIEDE2000, mean", record.fit?.mean, (v) => fixed(v, 2));
      put("CIEDE2000, largest", record.fit?.max, (v) => fixed(v, 2));
      put("CIEDE2000, each patch by the others", record.leave_one_out?.mean, (v) => fixed(v, 2));
  }
  return figures;
}
