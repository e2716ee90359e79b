import { useEffect, useRef, useState } from "preact/hooks";
import { api, type Region, type Session } from "./api";
import type { Live } from "./live";
import { watchLive } from "./mjpeg";
import { RegionFrame } from "./RegionFrame";
import { words } from "./words";

/** Pause before the stream is asked for again. */
const AGAIN_MS = 2000;
/** Kept for the tab alone: a page that is opened elsewhere must not start the camera's live view by itself. */
const REMEMBERED = "live-view";

export function LiveView({ live }: { live: Live }) {
  const [on, setOn] = useState(() => sessionStorage.getItem(REMEMBERED) === "on");
  const toggle = () => {
    sessionStorage.setItem(REMEMBERED, on ? "off" : "on");
    setOn(!on);
  };
  return (
    <div class="live">
      {on && <Picture live={live} />}
      <div class="tools">
        {on && live.session?.region && <ClearRegion live={live} session={live.session} />}
        <button type="button" class="quiet" onClick={toggle}>
          {on ? words.liveOff : words.liveOn}
        </button>
      </div>
    </div>
  );
}

function Picture({ live }: { live: Live }) {
  const image = useRef<HTMLImageElement>(null);
  const { seen, trouble } = useLivePicture(image);
  const session = live.session;
  const region = session?.region ?? null;
  const setRegion = async (wanted: Region | null) => {
    if (!session) return false;
    const kept = await live.attempt(api.setRegion(session.name, wanted).then(() => true));
    return kept ?? false;
  };
  return (
    <>
      <div class={seen ? "picture" : "picture waits"}>
        <img ref={image} alt={words.livePicture} draggable={false} />
        {session && seen && <RegionFrame key={session.name} region={region} onChange={setRegion} />}
        {!seen && !trouble && <p class="dim">{words.liveWaits}</p>}
        {trouble && (
          <p class="trouble" role="status">
            {trouble} <span class="dim">{words.liveAgain}</span>
          </p>
        )}
      </div>
      <p class="dim" id="region-help">
        {!session ? words.regionNeedsSession : region ? words.regionIs(region) : words.regionHelp}
      </p>
    </>
  );
}

function ClearRegion({ live, session }: { live: Live; session: Session }) {
  return (
    <button type="button" class="quiet" onClick={() => void live.attempt(api.setRegion(session.name, null))}>
      {words.regionClear}
    </button>
  );
}

/** Keeps the newest live picture in the image while the tab can be seen; after trouble it tries again. */
function useLivePicture(image: { current: HTMLImageElement | null }) {
  const [seen, setSeen] = useState(false);
  const [trouble, setTrouble] = useState<string | null>(null);
  const [visible, setVisible] = useState(!document.hidden);

  useEffect(() => {
    const changed = () => setVisible(!document.hidden);
    document.addEventListener("visibilitychange", changed);
    return () => document.removeEventListener("visibilitychange", changed);
  }, []);

  useEffect(() => {
    if (!visible) return;
    const end = new AbortController();
    const show = (jpeg: Blob) => {
      const element = image.current;
      if (!element || end.signal.aborted) return;
      const url = URL.createObjectURL(jpeg);
      element.onload = element.onerror = () => URL.revokeObjectURL(url);
      element.src = url;
      setSeen(true);
      setTrouble(null);
    };
    const watch = async () => {
      while (!end.signal.aborted) {
        try {
          await watchLive(show, end.signal);
        } catch (error) {
          if (end.signal.aborted) return;
          setTrouble(error instanceof Error ? error.message : String(error));
        }
        await new Promise((resume) => window.setTimeout(resume, AGAIN_MS));
      }
    };
    void watch();
    return () => end.abort();
  }, [visible, image]);

  return { seen, trouble };
}
