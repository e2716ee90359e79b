// A session's calibrations: what the API says of them, and the calls of their guides.

import { ask, type Exposure, type Job } from "./api";

export type Kind = "levels" | "noise" | "exposure" | "flat" | "flash" | "steadiness" | "colour";

export interface Take {
  role: string;
  name: string;
  words: string;
  count: string;
  /** The same as a number; 0 where none is needed. */
  wanted: number;
  /** Shots that wait and can be used. */
  taken: number;
}

/** What is to be shot. */
export interface ShotOrder {
  role: string;
  distance_m?: number;
  exposure?: Exposure;
  count?: number;
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
  /** What is wrong with its exposure. */
  fault?: string | null;
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
  /** What is still missing, in sentences. */
  lacks: string[];
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

/** As they were taken, as their numbers tell. */
export const byName = (files: Iterable<File>) =>
  [...files].sort((a, b) => a.name.localeCompare(b.name, "en", { numeric: true }));

/** How many stops brighter the other place of a dial is. */
const brighter = (dial: keyof Exposure, from: number, to: number) => {
  const stops = Math.log2(to / from);
  return dial === "aperture" ? -2 * stops : stops;
};

/** Exposures from `from` up, each about `stops` brighter by one dial, as far as that goes. */
export function ladder(
  from: Exposure,
  dial: keyof Exposure,
  places: number[],
  stops: number,
  steps: number,
): Exposure[] {
  const rungs = [from];
  while (rungs.length < steps) {
    const last = rungs[rungs.length - 1]!;
    const far = (place: number) => Math.abs(brighter(dial, last[dial], place) - stops);
    const further = places.filter((place) => brighter(dial, last[dial], place) > stops / 2);
    if (further.length === 0) break;
    const next = further.reduce((best, place) => (far(place) < far(best) ? place : best));
    rungs.push({ ...last, [dial]: next });
  }
  return rungs;
}

export const calibrations = {
  all: (session: string, signal: AbortSignal) => answer<Calibration[]>(ask(at(session), { signal })),
  record: (session: string, kind: Kind, signal: AbortSignal) =>
    answer<CalibrationRecord>(ask(`${at(session)}/${kind}`, { signal })),
  /** Has the camera shoot. */
  shoot: (session: string, kind: Kind, order: ShotOrder) =>
    answer<Job>(ask(`${at(session)}/${kind}/shots`, json(order))),
  /** Sends raw files, by name: their numbers tell in which order they were taken. `off` is without flash. */
  send: (session: string, kind: Kind, role: string, files: File[], distance_m?: number, off?: File) => {
    const form = new FormData();
    form.append("role", role);
    if (distance_m !== undefined) form.append("distance_m", String(distance_m));
    for (const file of byName(files)) form.append("file", file, file.name);
    if (off) form.append("off", off, off.name);
    return answer<CalibrationShot[]>(ask(`${at(session)}/${kind}/shots`, { method: "POST", body: form }));
  },
  remove: (session: string, kind: Kind, shot: string) =>
    ask(`${at(session)}/${kind}/shots/${encodeURIComponent(shot)}`, { method: "DELETE" }),
  fit: (session: string, kind: Kind, order: unknown) => answer<Job>(ask(`${at(session)}/${kind}`, json(order))),
};
