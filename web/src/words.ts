// Every sentence that the page says by itself. The server's own sentences are shown as they come.

import type { Job } from "./api";

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
};

const kinds: Record<string, string> = {
  pair: "Taking a pair",
  flash_shots: "Calibration shots",
  calibrate_flash: "Calibrating the flash",
  import_scene: "Importing the scene",
  process: "Making the model",
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
};

export function jobState(job: Job): string {
  return states[job.state];
}

export function counted(n: number, one: string, many: string): string {
  return `${n} ${n === 1 ? one : many}`;
}
