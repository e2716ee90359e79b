// What `docs/openapi.json` says, as far as the page uses it, and the few calls that it makes.

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
}

export type JobState = "queued" | "running" | "done" | "failed" | "cancelled";

export interface Job {
  id: number;
  kind: string;
  session: string;
  state: JobState;
  stage: string;
  done: number;
  total: number;
  problem: { code: string; words: string } | null;
}

export interface Session {
  name: string;
  current: boolean;
  pairs: number;
  accepted: number;
  has_scene: boolean;
  has_flash_calibration: boolean;
  results: { name: string; url: string }[];
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
  studio: Studio | null;
}

/** The server's own sentence, or one of ours when it could not be reached. */
export class ApiError extends Error {}

async function call<T>(method: string, path: string, body?: unknown): Promise<T> {
  let response: Response;
  try {
    const init: RequestInit = { method };
    if (body !== undefined) {
      init.headers = { "Content-Type": "application/json" };
      init.body = JSON.stringify(body);
    }
    response = await fetch(`/api/v1${path}`, init);
  } catch {
    throw new ApiError("The unlit program does not answer. Is it still running?");
  }
  if (!response.ok) {
    const problem = (await response.json().catch(() => null)) as { detail?: string } | null;
    throw new ApiError(problem?.detail ?? `The unlit program answered ${response.status}.`);
  }
  return (response.status === 204 ? undefined : await response.json()) as T;
}

const at = encodeURIComponent;

export const api = {
  lookForDevices: () => call<Devices>("GET", "/devices"),
  sessions: () => call<Session[]>("GET", "/sessions"),
  session: (name: string) => call<Session>("GET", `/sessions/${at(name)}`),
  openSession: (name: string) => call<Session>("POST", "/sessions", { name }),
  pairs: (session: string) => call<Pair[]>("GET", `/sessions/${at(session)}/pairs`),
  takePair: () => call<Job>("POST", "/pairs"),
  confirm: () => call<void>("POST", "/confirm"),
  cancel: (job: number) => call<Job>("DELETE", `/jobs/${job}`),
  process: (session: string) => call<Job>("POST", `/sessions/${at(session)}/process`),
};
