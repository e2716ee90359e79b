// What the page says by itself about sequences.

import type { Between, Order } from "./sequence";

export const sequenceWords = {
  sequence: "Sequence",
  planOne: "Plan a sequence",
  needsSession: "To plan one, make a session first (above) or take the first pair.",
  explain: "A walk round the object, counted: a pair at each position, and it goes on where it stopped.",
  positions: "Positions",
  between: "Each position waits for",
  kinds: {
    prompt: "the space bar",
    countdown: "a countdown",
    trigger_file: "a trigger file",
    hook: "a script",
  } satisfies Record<Between["kind"], string>,
  seconds: "Seconds to walk",
  interval: "Least seconds from pair to pair",
  order: "Frames of each pair",
  orders: {
    off_on: "off, on",
    on_off: "on, off",
    off_on_off: "off, on, off",
  } satisfies Record<Order, string>,
  offFrames: "Frames without flash in a row",
  plan: "Plan",
  start: "Start",
  pause: "Pause",
  resume: "Resume",
  skip: "Skip",
  again: "Take it again",
  wait: "Please wait",
  cancel: "End sequence",
  remove: "New sequence",
  takePosition: (position: number) => `Take position ${position}`,
  inSeconds: (seconds: number) => `in ${seconds} s`,
  progress: (done: number, of: number) => `${done} of ${of} positions done`,
  place: (position: number, state: string) => `Position ${position}: ${state}`,
  placeStates: { done: "done", skipped: "skipped", here: "here", missing: "to come" },
};
