// What the page says by itself about calibrations; what to do and the verdicts are the server's own sentences.

import type { Lighting } from "./api";
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
    steadiness: "The camera with the ring flash before a plain surface, nothing changed from shot to shot",
    colour: "The camera with the flash before a colour chart that lies flat",
  } satisfies Record<Kind, string>,
  shoot: (count: number) => (count === 1 ? "Take one" : `Take ${count}`),
  shootCard: (count: number) => (count === 1 ? "Take card shot" : `Take ${count} card shots`),
  shootLadder: (steps: number, count: number) =>
    count === 1 ? `Take ${steps} steps` : `Take ${steps} steps, ${count} frames each`,
  taken: (taken: number, wanted: number) =>
    wanted === 0 ? "Not needed in a dark room." : `${taken} of ${wanted} good`,
  inARow: "Shots in a row",
  dials: "Dials for the next shot",
  dialsStay: "as the camera stands",
  dialsBack: "Afterwards they go back to where they were.",
  climb: "From shot to shot",
  climbs: {
    none: "the same",
    shutter_s: "brighter by the shutter",
    aperture: "brighter by the aperture",
    iso: "brighter by the ISO",
  },
  steps: "Steps",
  lacks: "Still missing",
  complete: "Everything is there. Measure.",
  send: "Or send raw files",
  sendCards: "Or send lit raw files, all at this distance",
  sendOffs: "Their frames without flash, if the room is not dark: as many, or one for all",
  sendThem: "Send",
  unequal: (lit: number, off: number) => `${lit} lit files and ${off} without flash do not go together.`,
  sending: "Sending…",
  distance: "Distance from lens to card, metres",
  shots: "Shots for the next measurement",
  noShots: "No shots yet.",
  shot: (name: string, exposure: string) => (exposure === "" ? name : `${name}: ${exposure}`),
  metres: (distance: number) => `${distance} m`,
  mean: (share: number) => `mean ${percent(share, share < 0.1 ? 1 : 0)}`,
  clipped: (share: number) => `, ${percent(share, share < 0.01 ? 2 : 0)} clipped`,
  used: "in use",
  remove: "Throw away",
  checkOnly: "only to check the fit",
  removeShot: (n: number, name: string) => `Throw away shot ${n}, ${name}`,
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
  more: "More",
  fitRadii: "Let shots near the card tell the radii",
  tagSize: "AprilTags on the card: side of the black square, millimetres (empty: none)",
  oneShot: "Instead: correct what was measured by one shot, for another power of the flash",
  noOneShot: "no, measure anew",
  corners: "Corner patches of the chart, X,Y in pixels, if it is not found: 812,1034 2210,1040 2215,1980 805,1975",
  lighting: "Polariser and flash power",
  polariser: "A polariser is before the lens",
  angle: "Its angle, degrees (empty: not read)",
  power: "Power of the flash, of its full power: 1, 0.5, 0.25 (empty: not told)",
  set: "Set",
  lightingNow: ({ polariser, flash_power }: Lighting) =>
    [
      !polariser ? "no polariser" : `polariser at ${polariser.angle_degrees ?? "an unknown angle"}`,
      flash_power == null ? "power not told" : `flash at ${flash_power} of its power`,
    ].join(", "),
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
      put("of it not the sensor's noise", record.misfit_rms, (v) => percent(v, 2));
      break;
    case "steadiness":
      put("standard deviation from shot to shot", record.jitter_deviation, (v) => percent(v, 3));
      put("left when divided by the measured energy", record.corrected_deviation, (v) => percent(v, 3));
      put("from the first to the last shot", record.drift, (v) => percent(v, 3));
      put("frames", record.frames?.length, (v) => fixed(v, 0));
      break;
    case "colour":
      put("CIEDE2000, mean", record.fit?.mean, (v) => fixed(v, 2));
      put("CIEDE2000, largest", record.fit?.max, (v) => fixed(v, 2));
      put("CIEDE2000, each patch by the others", record.leave_one_out?.mean, (v) => fixed(v, 2));
  }
  return figures;
}
