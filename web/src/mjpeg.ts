// The live stream read by hand. An `img` element would show it too, but browsers do not tell it when the stream
// has ended, and the operator would aim by a picture that stands still without knowing.

import { ApiError, ask } from "./api";
import { words } from "./words";

const HEAD_END = [13, 10, 13, 10];

/** Calls `show` with each picture until the stream ends; throws the server's sentence if there is none. */
export async function watchLive(show: (jpeg: Blob) => void, signal: AbortSignal): Promise<void> {
  const response = await ask("/live.mjpg", { signal, cache: "no-store" });
  const reader = response.body?.getReader();
  if (!reader) throw new ApiError(words.liveUnreadable);
  let held = new Uint8Array();
  for (;;) {
    const { value, done } = await reader.read();
    if (done) return;
    held = joined(held, value);
    const { newest, rest } = parts(held);
    held = rest;
    if (newest) show(new Blob([newest], { type: "image/jpeg" }));
  }
}

/** The newest whole picture in `bytes`, if any, and what comes after it. */
function parts(bytes: Uint8Array<ArrayBuffer>) {
  let newest: Uint8Array<ArrayBuffer> | null = null;
  let from = 0;
  for (;;) {
    const body = afterHead(bytes, from);
    if (body === null) break;
    const head = new TextDecoder("latin1").decode(bytes.subarray(from, body));
    const length = /content-length:\s*(\d+)/i.exec(head)?.[1];
    if (length === undefined) throw new ApiError(words.liveUnreadable);
    const end = body + Number(length);
    if (end > bytes.length) break;
    newest = bytes.slice(body, end);
    from = end;
  }
  return { newest, rest: bytes.slice(from) };
}

/** Where the body begins whose head begins at or after `from`. */
function afterHead(bytes: Uint8Array, from: number): number | null {
  for (let i = from; i + HEAD_END.length <= bytes.length; i++) {
    if (HEAD_END.every((byte, k) => bytes[i + k] === byte)) return i + HEAD_END.length;
  }
  return null;
}

function joined(a: Uint8Array, b: Uint8Array): Uint8Array<ArrayBuffer> {
  const both = new Uint8Array(a.length + b.length);
  both.set(a);
  both.set(b, a.length);
  return both;
}
