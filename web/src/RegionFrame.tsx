import { useEffect, useRef, useState } from "preact/hooks";
import type { Region } from "./api";
import { afterKey, between, bigEnough, type Point } from "./region";
import { words } from "./words";

/** So long after the last key the region is sent. */
const KEYS_REST_MS = 500;

interface Props {
  region: Region | null;
  /** Resolves with whether it was kept. */
  onChange: (region: Region | null) => Promise<boolean>;
}

/** Lies over the picture: shows the region, and lets it be drawn with mouse, finger, pen or keys. */
export function RegionFrame({ region, onChange }: Props) {
  // What is drawn but not yet the session's; undefined when there is no such thing.
  const [draft, setDraft] = useState<Region | null | undefined>(undefined);
  const start = useRef<Point | null>(null);
  // What the keys have made of it, to be sent when they rest or the picture goes.
  const typed = useRef<{ timer: number; wanted: Region | null } | null>(null);
  const shown = draft === undefined ? region : draft;

  useEffect(() => {
    if (!start.current && !typed.current) setDraft(undefined);
  }, [region]);

  const keep = async (wanted: Region | null) => {
    if (!(await onChange(wanted))) setDraft(undefined);
  };
  const send = () => {
    if (!typed.current) return;
    window.clearTimeout(typed.current.timer);
    const { wanted } = typed.current;
    typed.current = null;
    void keep(wanted);
  };
  useEffect(() => send, []);
  const point = (event: PointerEvent): Point => {
    const box = (event.currentTarget as HTMLElement).getBoundingClientRect();
    return { x: (event.clientX - box.left) / box.width, y: (event.clientY - box.top) / box.height };
  };
  const drop = () => {
    start.current = null;
    setDraft(undefined);
  };

  const down = (event: PointerEvent) => {
    if (!event.isPrimary || event.button !== 0) return;
    (event.currentTarget as HTMLElement).setPointerCapture(event.pointerId);
    window.clearTimeout(typed.current?.timer);
    typed.current = null;
    start.current = point(event);
  };
  const move = (event: PointerEvent) => {
    if (!start.current || !event.isPrimary) return;
    const drawn = between(start.current, point(event));
    if (bigEnough(drawn)) setDraft(drawn);
  };
  const up = (event: PointerEvent) => {
    if (!start.current || !event.isPrimary) return;
    const drawn = between(start.current, point(event));
    start.current = null;
    if (bigEnough(drawn)) {
      setDraft(drawn);
      void keep(drawn);
    } else {
      setDraft(undefined);
    }
  };
  const key = (event: KeyboardEvent) => {
    if (event.ctrlKey || event.metaKey || event.altKey) return;
    if (event.key === "Escape" && start.current) return drop();
    const changed = afterKey(shown, event.key, event.shiftKey);
    if (changed === undefined) return;
    event.preventDefault();
    setDraft(changed);
    window.clearTimeout(typed.current?.timer);
    typed.current = { timer: window.setTimeout(send, KEYS_REST_MS), wanted: changed };
  };

  return (
    <div
      class="region"
      role="application"
      aria-roledescription={words.regionRole}
      aria-label={shown ? words.regionIs(shown) : words.regionNone}
      aria-describedby="region-help"
      tabIndex={0}
      // The mouse leaves the focus, and with it the arrow keys, where they are.
      onMouseDown={(event) => event.preventDefault()}
      onPointerDown={down}
      onPointerMove={move}
      onPointerUp={up}
      onPointerCancel={drop}
      onKeyDown={key}
    >
      {shown && (
        <span
          class="drawn"
          style={{
            left: `${shown.x * 100}%`,
            top: `${shown.y * 100}%`,
            width: `${shown.width * 100}%`,
            height: `${shown.height * 100}%`,
          }}
        />
      )}
    </div>
  );
}
