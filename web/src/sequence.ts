// A session's sequence: what the API says of it, the calls that direct it, and what the large button means meanwhile.

import { useEffect, useState } from "preact/hooks";
import { ask } from "./api";
import type { Live } from "./live";
import { sequenceWords as words } from "./sequenceWords";

export type Between =
  | { kind: "prompt" }
  | { kind: "countdown"; seconds: number }
  | { kind: "trigger_file" }
  | { kind: "hook" };

export type Order = "off_on" | "on_off" | "off_on_off";

export interface SequencePlan {
  positions: number;
  between: Between;
  interval_s: number;
  retries: number;
  order: Order;
  off_frames: number;
  instructions: string[];
}

export interface Sequence {
  session: string;
  state: "planned" | "waiting" | "resting" | "shooting" | "paused" | "asking" | "done" | "cancelled" | "removed";
  pausing: boolean;
  position: number | null;
  done: number;
  skipped: number;
  seconds_left: number | null;
  guide: string | null;
  words: string;
  plan: SequencePlan;
  positions: { position: number; pairs: number[]; accepted: number | null; skipped: boolean }[];
}

export type Wish = "start" | "pause" | "resume" | "next" | "retry" | "skip" | "cancel";

const at = (session: string) => `/sessions/${encodeURIComponent(session)}/sequence`;

const json = (method: string, body: unknown): RequestInit => ({
  method,
  headers: { "Content-Type": "application/json" },
  body: JSON.stringify(body),
});

export const sequences = {
  plan: (session: string, plan: SequencePlan) => ask(at(session), json("PUT", plan)),
  /** With a position, the word is refused if somebody else was faster. */
  tell: (session: string, wish: Wish, position?: number | null) =>
    ask(`${at(session)}/${wish}`, position == null ? { method: "POST" } : json("POST", { position })),
  remove: (session: string) => ask(at(session), { method: "DELETE" }),
};

/** The list with one sequence as it stands now. */
export function withSequence(all: Sequence[], changed: Sequence): Sequence[] {
  const others = all.filter((sequence) => sequence.session !== changed.session);
  return changed.state === "removed" ? others : [...others, changed];
}

/** The current session's. */
export function currentSequence(live: Live): Sequence | null {
  const { state } = live;
  return state?.sequences.find((sequence) => sequence.session === state.session) ?? null;
}

/** What the large button and the space bar mean; null where they take a pair as ever. */
export function stepOf(sequence: Sequence | null): { label: string; act: (() => Promise<unknown>) | null } | null {
  if (!sequence) return null;
  const { session, position, state } = sequence;
  const tell = (wish: Wish) => () => sequences.tell(session, wish, position);
  switch (state) {
    case "waiting":
      return { label: words.takePosition(position ?? 0), act: tell("next") };
    case "asking":
      return { label: words.again, act: tell("retry") };
    case "paused":
      return { label: words.resume, act: tell("resume") };
    case "resting":
    case "shooting":
      return { label: words.wait, act: null };
    default:
      return null;
  }
}

/** Whole seconds until it goes on by itself, counted down here. */
export function useSecondsLeft(sequence: Sequence | null): number | null {
  const [left, setLeft] = useState<number | null>(null);
  useEffect(() => {
    const seconds = sequence?.seconds_left ?? null;
    if (seconds === null) {
      setLeft(null);
      return;
    }
    const end = performance.now() + seconds * 1000;
    const show = () => setLeft(Math.max(0, Math.ceil((end - performance.now()) / 1000)));
    show();
    const timer = setInterval(show, 200);
    return () => clearInterval(timer);
  }, [sequence]);
  return left;
}
