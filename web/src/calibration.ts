// A session's calibrations: what the API says of them, and the calls of their guides.

import { ask, type Job } from "./api";

export type Kind = "levels" | "noise" | "exposure" | "flat" | "flash" | "colour";

export interface Take {
  role: string;
  name: string;
  words: string;
  count: string;
}

export interface CalibrationShot {
  id: string;
  role: string;
  distance_m?: number | null;
  url: string;
  exposure: string;
  /** Mean of the brightest colour, 0 at black and 1 at saturation. */
  mean_share?: number | null;
  clipped_share?: number | null;
  reasons: string[];
  in_record: boolean;
}

export interface Measured {
  measured: string;
  good: boolean;
  sentences: string[];
  validity: { words: string };
  shots: number;
  files: { name: string; url: string }[];
}

export interface Calibration {
  kind: Kind;
  guide: { title: string; gives: string; steps: string[]; takes: Take[]; command: string };
  shots: CalibrationShot[];
  measured?: Measured | null;
  unreadable?: string | null;
}

/** A record as it is kept; its shape depends on the kind. */
// biome-ignore lint: its fields are looked at one by one
export type CalibrationRecord = Record<string, any>;

const at = (session: string) => `/sessions/${encodeURIComponent(session)}/calibration`;

const json = (body: unknown): RequestInit => ({
  method: "POST",
  headers: { "Content-Type": "application/json" },
  body: JSON.stringify(body),
});

const answer = async <T>(asked: Promise<Response>) => (await (await asked).json()) as T;

export const calibrations = {
  all: (session: string, signal: AbortSignal) => answer<Calibration[]>(ask(at(session), { signal })),
  record: (session: string, kind: Kind, signal: AbortSignal) =>
    answer<CalibrationRecord>(ask(`${at(session)}/${kind}`, { signal })),
  /** Has the camera shoot. */
  shoot: (session: string, kind: Kind, order: { role: string; distance_m?: number }) =>
    answer<Job>(ask(`${at(session)}/${kind}/shots`, json(order))),
  /** Sends raw files, by name: their numbers tell in which order they were taken. */
  send: (session: string, kind: Kind, role: string, files: File[], distance_m?: number) => {
    const form = new FormData();
    form.append("role", role);
    if (distance_m !== undefined) form.append("distance_m", String(distance_m));
    const sorted = [...files].sort((a, b) => a.name.localeCompare(b.name, "en", { numeric: true }));
    for (const file of sorted) form.append("file", file, file.name);
    return answer<CalibrationShot[]>(ask(`${at(session)}/${kind}/shots`, { method: "POST", body: form }));
  },
  remove: (session: string, kind: Kind, shot: string) =>
    ask(`${at(session)}/${kind}/shots/${encodeURIComponent(shot)}`, { method: "DELETE" }),
  fit: (session: string, kind: Kind, order: unknown) => answer<Job>(ask(`${at(session)}/${kind}`, json(order))),
};
