// Every sentence that the page says by itself. The server's own sentences are shown as they come.

import type { Exposure, FoundExposure, Job, Pulse, Reason, Region, Repeatability } from "./api";

const percent = (share: number, digits: number) => `${(share * 100).toFixed(digits)} %`;

const labels = {
  shutter_s: (s: number) => (s < 0.29 ? `1/${Math.round(1 / s)} s` : `${s} s`),
  aperture: (n: number) => `f/${n}`,
  iso: (iso: number) => `ISO ${iso}`,
};

const exposure = (e: Exposure) =>
  [labels.shutter_s(e.shutter_s), labels.aperture(e.aperture), labels.iso(e.iso)].join(", ");

const size = (r: Region) => `${percent(r.width, 0)} by ${percent(r.height, 0)}`;

export const words = {
  take: "Take pair",
  taking: "Taking…",
  space: "or press the space bar",
  cancel: "Cancel",
  confirm: "Done",
  idle: "Ready for the first pair.",
  afterAccepted: (n: number) => `Pair ${n} is good.`,
  afterRejected: (n: number) => `Pair ${n} was rejected.`,
  devices: "Devices",
  camera: "Camera",
  flash: "Flash",
  lookAgain: "Look again",
  looking: "Looking…",
  notReady: "Not ready",
  session: "Session",
  noSession: "none yet: the first pair makes one",
  otherSession: "Other session",
  newSession: "New session",
  newSessionName: "Name",
  create: "Create",
  pairs: "Pairs",
  noPairs: "No pairs yet.",
  noCopy: "no second copy: see above",
  room: (pairs: number) => `room for ${pairs} more`,
  off: "Flash off",
  on: "Flash on",
  accepted: "Accepted",
  rejected: "Rejected",
  processing: "Processing",
  waitsFor: (what: string) => `The model is made as soon as the session has ${what}.`,
  scene: "a scene (cameras and mesh)",
  calibration: "a flash calibration",
  pairMissing: "an accepted pair",
  and: " and ",
  nothingRuns: "Everything is processed.",
  again: "Process now",
  lost: "No connection to the unlit program. Trying again…",
  studio: "Simulated studio",
  dismiss: "Dismiss",
  noAnswer: "The unlit program does not answer. Is it still running?",
  answered: (status: number) => `The unlit program answered ${status}.`,
  unknown: "–",

  flashLight: "Flash light",
  energies: (pulses: number, reach: number) =>
    `Energy of ${pulses} pulses, within ${percent(reach, 1)} of their mean`,
  energy: (p: Pulse) =>
    `Pair ${p.pair}: ${p.gain.toFixed(4)} ± ${p.deviation.toFixed(4)} of the reference energy`,
  energyScale: (reach: number) => `Energy pair by pair, scale ± ${percent(reach, 1)}`,
  repeatability: (r: Repeatability) =>
    `Known light over ${r.shots} shots: ${percent(r.spread, 3)} as it came` +
    (r.corrected == null ? "." : `, ${percent(r.corrected, 3)} by energy.`),

  cameraInUse: "Camera in use",
  noCameraInUse: "none",

  liveOn: "Live view",
  liveOff: "End live view",
  livePicture: "Live picture of the camera",
  liveWaits: "Waiting for the first picture…",
  liveAgain: "Trying again…",
  liveUnreadable: "The live picture cannot be read; load the page again.",
  regionRole: "region of interest",
  regionNone: "No region: the whole frame counts.",
  regionIs: (r: Region) => `The region is ${size(r)} of the frame. Draw again to change it.`,
  regionHelp: "Draw a rectangle round the object. With keys: Enter and arrows, with Shift for its size, Delete.",
  regionNeedsSession: "To draw the object's region, make a session first (above) or take the first pair.",
  regionClear: "Clear region",

  exposure: "Exposure",
  exposureWaits: "Waits for the camera.",
  exposureNeedsSession: "To set it, make a session first (above) or take the first pair.",
  checkAgain: "Check again",
  lockedAt: (plan: string) => `Locked at ${plan}.`,
  notLocked: (e: Exposure) => `The camera stands at ${exposure(e)}; the first pair locks that.`,
  setWithNextPair: (e: Exposure) => `The camera stands at ${exposure(e)} and is set with the next pair.`,
  cameraTellsNoExposure: "The camera does not tell its exposure. Is it in mode M?",
  dials: { shutter_s: "Shutter", aperture: "Aperture", iso: "ISO" },
  labels: { ...labels, iso: (iso: number) => String(iso) },
  bothFrames: "Both frames",
  withFlash: "With flash",
  withoutFlash: "Without flash",
  separateOff: "Another exposure without flash",
  set: "Set",
  findExposure: "Find exposure",
  findInRegion: "Finding takes up to four test shots and looks at the region alone.",
  findInFrame: "Finding takes up to four test shots; without a region it looks at the whole frame.",
  found: ({ exposure: plan, predicted_share, shots }: FoundExposure) =>
    `Found ${plan.words} with ${counted(shots, "test shot", "test shots")}: the brightest colour of the lit frame ` +
    `should end at ${percent(predicted_share, 0)} of saturation.`,
  useFound: "Use it",

  lockUnknown:
    "The other settings of this camera are not checked. Make sure of mode M, manual focus, a fixed white balance " +
    "and raw files.",
  lockWrong: "To be put right before the next pair",
  lockWarns: "To be thought of",
  lockUnreadable: "The camera does not tell; please look",
  checked: "I have checked this",
  checkedByEye: (sentence: string) => `${sentence} (checked by eye)`,
  checkedNeedsSession: "Kept with the session: make one first (above) or take the first pair.",
  lockGood: (settings: string) => `${settings} as needed`,

  lastPair: (n: number) => `Pair ${n}`,
  figure: ({ figure, limit, code }: Reason) =>
    `Measured ${figures(figure)}, limit ${figures(limit)} (${code.replaceAll("_", " ")}).`,
  scale: "Scale of the histograms",
  scales: { logarithmic: "Logarithmic", linear: "Linear" },
  histogram: (frame: string, scale: string) => `Raw histogram, ${frame.toLowerCase()}, ${scale}`,
  histogramsWait: "Counting the sensor values…",
  black: "black",
  saturation: "saturation",
  colours: { red: "Red", green: "Green", blue: "Blue" },
  brightest: "Brightest",
  clipped: "Clipped",
  clippedInRegion: "Clipped in region",
  clippedInFrame: "In frame",
  level: (share: number) => percent(share, 0),
  share: (share: number) =>
    share === 0 ? "0 %" : share < 0.0001 ? "< 0.01 %" : percent(share, share < 0.1 ? 2 : 0),
};

function figures(value: number): string {
  return value === 0 || Number.isInteger(value) ? String(value) : String(Number(value.toPrecision(3)));
}

const kinds: Record<string, string> = {
  pair: "Taking a pair",
  flash_shots: "Calibration shots",
  calibration_shot: "Calibration frame",
  calibrate_levels: "Measuring the sensor's levels",
  calibrate_noise: "Measuring noise and linearity",
  calibrate_exposure: "Measuring the exposure steps",
  calibrate_flat: "Measuring the vignetting",
  calibrate_flash: "Calibrating the flash",
  calibrate_steadiness: "Measuring how steady the flash is",
  calibrate_colour: "Measuring the colours",
  import_scene: "Importing the scene",
  develop: "Developing the pair",
  process: "Making the model",
  find_exposure: "Finding the exposure",
  repeatability: "Measuring how steady the flash is",
};

export function jobTitle(job: Job): string {
  return kinds[job.kind] ?? job.kind;
}

const states: Record<Job["state"], string> = {
  queued: "waiting",
  running: "running",
  done: "done",
  failed: "failed",
  cancelled: "cancelled",
  interrupted: "interrupted",
};

export function jobState(job: Job): string {
  return states[job.state];
}

export function counted(n: number, one: string, many: string): string {
  return `${n} ${n === 1 ? one : many}`;
}
