// Rectangles as shares of the frame: what the hand draws and the keys change.

import type { Region } from "./api";

export interface Point {
  x: number;
  y: number;
}

/** Anything smaller was a slip of the hand, not a region. */
const SMALLEST = 0.02;
const STEP = 0.01;

const within = (v: number, low: number, high: number) => Math.min(Math.max(v, low), high);
const tidy = (v: number) => Math.round(v * 1e4) / 1e4;

/** The region between two corners, cut to the frame. */
export function between(a: Point, b: Point): Region {
  const [left, right] = [a.x, b.x].map((v) => within(v, 0, 1)).sort((p, q) => p - q) as [number, number];
  const [top, bottom] = [a.y, b.y].map((v) => within(v, 0, 1)).sort((p, q) => p - q) as [number, number];
  return { x: tidy(left), y: tidy(top), width: tidy(right - left), height: tidy(bottom - top) };
}

export function bigEnough(region: Region): boolean {
  return region.width >= SMALLEST && region.height >= SMALLEST;
}

const MIDDLE: Region = { x: 0.25, y: 0.25, width: 0.5, height: 0.5 };

const ARROWS: Record<string, Point> = {
  ArrowLeft: { x: -STEP, y: 0 },
  ArrowRight: { x: STEP, y: 0 },
  ArrowUp: { x: 0, y: -STEP },
  ArrowDown: { x: 0, y: STEP },
};

/** What a key makes of the region: `null` clears it, `undefined` means that the key is not for it. */
export function afterKey(region: Region | null, key: string, shift: boolean): Region | null | undefined {
  if (key === "Delete" || key === "Backspace") return region ? null : undefined;
  if (key === "Enter") return region ? undefined : MIDDLE;
  const by = ARROWS[key];
  if (!by) return undefined;
  if (!region) return MIDDLE;
  const { x, y, width, height } = region;
  if (shift) {
    return {
      x,
      y,
      width: tidy(within(width + by.x, SMALLEST, 1 - x)),
      height: tidy(within(height + by.y, SMALLEST, 1 - y)),
    };
  }
  return { x: tidy(within(x + by.x, 0, 1 - width)), y: tidy(within(y + by.y, 0, 1 - height)), width, height };
}
