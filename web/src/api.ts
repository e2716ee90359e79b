// What `docs/openapi.json` says, as far as the page uses it, and the few calls that it makes.

import type { Sequence } from "./sequence";
import { words } from "./words";

export interface DeviceState {
  ready: boolean;
  description: string;
  words: string;
}

export interface Devices {
  camera: DeviceState;
  flash: DeviceState;
}

export interface Reason {
  code: string;
  figure: number;
  limit: number;
  sentence: string;
}

export interface Frame {
  file: string;
  url: string;
  thumbnail: string;
  bytes: number;
  settings: string;
}

export interface Pair {
  number: number;
  name: string;
  verdict: "accepted" | "rejected";
  reasons: Reason[];
  off: Frame;
  on: Frame;
  flash?: { words: string } | null;
}

/** One measured pulse of an accepted pair. */
export interface Pulse {
  pair: number;
  rest_s?: number | null;
  energy_counts: number;
  /** Energy against the reference, and its standard deviation. */
  gain: number;
  deviation: number;
}

export interface Repeatability {
  shots: number;
  spread: number;
  /** Divided by the measured energy; null where energies are not known. */
  corrected?: number | null;
}

/** What a session's pairs tell of the flash. */
export interface FlashAccount {
  words: string;
  advice: { code: string; sentence: string }[];
  pairs: number;
  misfires: number;
  pulses: Pulse[];
  repeatability?: Repeatability | null;
}

export type JobState = "queued" | "running" | "done" | "failed" | "cancelled" | "interrupted";

export interface Job {
  id: number;
  kind: string;
  session: string;
  state: JobState;
  stage: string;
  done: number;
  total: number;
  result?: unknown;
  problem: { code: string; words: string } | null;
}

/** Values as the camera labels them: seconds, f-number, ISO. */
export interface Exposure {
  shutter_s: number;
  aperture: number;
  iso: number;
}

export interface Plan {
  off: Exposure;
  on: Exposure;
  words: string;
}

/** What a job of kind `find_exposure` found. */
export interface FoundExposure {
  exposure: Plan;
  predicted_share: number;
  shots: number;
  warnings: string[];
}

/** Shares of the frame, from its top left corner. */
export interface Region {
  x: number;
  y: number;
  width: number;
  height: number;
}

export interface LockItem {
  name: string;
  state: "locked" | "corrected" | "wrong" | "unreadable" | "warning";
  value: string;
  sentence: string;
}

export interface Camera {
  model: string;
  port: string;
  exposure?: Exposure | null;
  offered: { shutters_s: number[]; apertures: number[]; isos: number[] };
  lock: LockItem[];
}

export interface ListedCamera {
  model: string;
  port: string;
  in_use: boolean;
}

export interface ColourFigures {
  colour: "red" | "green" | "blue";
  /** Black and saturation, DN: the edges of the bins. */
  from_dn: number;
  to_dn: number;
  bins: number[];
  below_black: number;
  at_saturation: number;
  /** Shares of the region and of the whole frame, 0 to 1. */
  clipped_share: number;
  frame_clipped_share: number;
  maximum_dn?: number | null;
}

export interface FrameFigures {
  colours: ColourFigures[];
}

export interface Session {
  name: string;
  current: boolean;
  pairs: number;
  accepted: number;
  has_scene: boolean;
  has_flash_calibration: boolean;
  exposure?: Plan | null;
  region?: Region | null;
  lighting: Lighting;
  confirmed: string[];
  results: { name: string; url: string }[];
  room?: { free_bytes: number; pairs?: number | null } | null;
  mirror?: Mirror | null;
}

/** What no file tells of how photographs are lit and seen. */
export interface Lighting {
  /** Absent: none. */
  polariser?: { angle_degrees?: number | null } | null;
  /** Part of its full power; absent: not told. */
  flash_power?: number | null;
}

/** The second copy on another disk. */
export interface Mirror {
  state: "behind" | "in_step" | "failing";
  words: string;
}

export interface Studio {
  words: string;
  stop: number | null;
  stops: number;
}

export interface State {
  version: string;
  devices: Devices;
  session: string | null;
  jobs: Job[];
  prompt: string | null;
  /** Of the sessions that are open. */
  sequences: Sequence[];
  studio: Studio | null;
}

/** The server's own sentence, or one of ours when it could not be reached. */
export class ApiError extends Error {}

/** Asks, and throws an `ApiError` with the server's own sentence unless the answer is a good one. */
export async function ask(path: string, init: RequestInit): Promise<Response> {
  let response: Response;
  try {
    response = await fetch(`/api/v1${path}`, init);
  } catch (error) {
    if (init.signal?.aborted) throw error;
    throw new ApiError(words.noAnswer);
  }
  if (!response.ok) {
    const problem = (await response.json().catch(() => null)) as { detail?: string } | null;
    throw new ApiError(problem?.detail ?? words.answered(response.status));
  }
  return response;
}

async function call<T>(method: string, path: string, body?: unknown, signal?: AbortSignal): Promise<T> {
  const init: RequestInit = { method, signal: signal ?? null };
  if (body !== undefined) {
    init.headers = { "Content-Type": "application/json" };
    init.body = JSON.stringify(body);
  }
  const response = await ask(path, init);
  return (response.status === 204 ? undefined : await response.json()) as T;
}

/** A whole list, page by page. */
async function all<T>(path: string): Promise<T[]> {
  const entries: T[] = [];
  let next: string | undefined = path;
  while (next !== undefined) {
    const response: Response = await ask(next, {});
    entries.push(...((await response.json()) as T[]));
    next = response.headers.get("Link")?.match(/<\/api\/v1([^>]+)>; rel="next"/)?.[1];
  }
  return entries;
}

const at = encodeURIComponent;

export const api = {
  lookForDevices: () => call<Devices>("GET", "/devices"),
  sessions: () => call<Session[]>("GET", "/sessions"),
  session: (name: string) => call<Session>("GET", `/sessions/${at(name)}`),
  openSession: (name: string) => call<Session>("POST", "/sessions", { name }),
  pairs: (session: string) => all<Pair>(`/sessions/${at(session)}/pairs`),
  flash: (session: string, signal: AbortSignal) =>
    call<FlashAccount>("GET", `/sessions/${at(session)}/flash`, undefined, signal),
  takePair: () => call<Job>("POST", "/pairs"),
  confirm: () => call<void>("POST", "/confirm"),
  cancel: (job: number) => call<Job>("DELETE", `/jobs/${job}`),
  process: (session: string) => call<Job>("POST", `/sessions/${at(session)}/process`),
  camera: () => call<Camera>("GET", "/camera"),
  cameras: () => call<ListedCamera[]>("GET", "/cameras"),
  chooseCamera: (port: string) => call<Devices>("PUT", "/camera", { port }),
  setExposure: (session: string, on: Exposure, off: Exposure | null) =>
    call<Plan>("PUT", `/sessions/${at(session)}/exposure`, { on, off }),
  findExposure: (session: string, separateOff: boolean) =>
    call<Job>("POST", `/sessions/${at(session)}/find-exposure`, { separate_off: separateOff }),
  setRegion: (session: string, region: Region | null) =>
    call<void>("PUT", `/sessions/${at(session)}/region`, region),
  setLighting: (session: string, lighting: Lighting) =>
    call<void>("PUT", `/sessions/${at(session)}/lighting`, lighting),
  confirmSettings: (session: string, names: string[]) =>
    call<{ names: string[] }>("POST", `/sessions/${at(session)}/confirmed`, { names }),
  histogram: (session: string, pair: number, frame: "off" | "on", signal: AbortSignal) =>
    call<FrameFigures>("GET", `/sessions/${at(session)}/pairs/${pair}/${frame}/histogram`, undefined, signal),
};
