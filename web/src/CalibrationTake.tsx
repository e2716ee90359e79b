import { useEffect, useState } from "preact/hooks";
import type { Camera, Exposure } from "./api";
import { byName, calibrations, type Kind, ladder, type ShotOrder, type Take } from "./calibration";
import { calibrationWords as words } from "./calibrationWords";
import { useCamera } from "./camera";
import { type Chosen, complete, Dials, onDials } from "./Dials";
import { Field } from "./Field";
import type { Live } from "./live";
import { words as common } from "./words";

type Dial = keyof Exposure;

/** How a series goes from shot to shot, as its guide says. */
interface Series {
  /** Whether it is a ladder. */
  climbs: boolean;
  /** From one step to the next. */
  stops: number;
  steps: number;
  /** Shots in a row, of a step if it climbs. */
  count: number;
}

const series = (kind: Kind, take: Take): Series => {
  if (take.role === "step") return { climbs: true, stops: 1 / 3, steps: 10, count: 1 };
  if (kind === "noise" && take.role === "even") return { climbs: true, stops: 1, steps: 8, count: 2 };
  if (take.role === "lit") return { climbs: false, stops: 0, steps: 1, count: Math.max(1, take.wanted - take.taken) };
  return { climbs: false, stops: 0, steps: 1, count: take.role === "card" ? 3 : 1 };
};

interface Props {
  live: Live;
  session: string;
  kind: Kind;
  take: Take;
  distance: string;
}

/** Frames of one role: how, how many there are, the button, and the field for files. */
export function TakeOne({ live, session, kind, take, distance }: Props) {
  const usual = series(kind, take);
  const [inARow, setInARow] = useState("");
  const [exposures, setExposures] = useState<Exposure[]>([]);
  const isCard = kind === "flash";
  const count = Math.min(100, Math.max(1, Math.round(Number(inARow) || usual.count)));
  const shoot = async () => {
    const order: ShotOrder = { role: take.role, count, ...(isCard ? { distance_m: Number(distance) } : {}) };
    const each = exposures.length > 0 ? exposures.map((exposure) => ({ ...order, exposure })) : [order];
    for (const one of each) {
      if (!(await live.attempt(calibrations.shoot(session, kind, one)))) break;
    }
  };
  const label =
    exposures.length > 1
      ? words.shootLadder(exposures.length, count)
      : isCard
        ? words.shootCard(count)
        : words.shoot(count);
  return (
    <fieldset>
      <legend>
        {take.name} <span class="dim">{take.count}</span>
      </legend>
      <p class="dim">{take.words}</p>
      <p class="taken">
        {words.taken(take.taken, take.wanted)}
        {take.wanted > 0 && (
          <progress value={Math.min(take.taken, take.wanted)} max={take.wanted} aria-label={take.name} />
        )}
      </p>
      {!isCard && <NextDials live={live} usual={usual} onChange={setExposures} />}
      <div class="actions">
        <Field whole label={words.inARow} value={inARow} hint={usual.count} least={1} most={100} free onChange={setInARow} />
        <button type="button" disabled={live.rigJob !== null} onClick={() => void shoot()}>
          {label}
        </button>
      </div>
      {isCard ? (
        <SendCards {...{ live, session, take, distance }} />
      ) : (
        <Send {...{ live, session, kind, take }} />
      )}
    </fieldset>
  );
}

/** Where the dials are to stand for the next shot, and how they climb from one to the next. */
function NextDials({ live, usual, onChange }: { live: Live; usual: Series; onChange: (e: Exposure[]) => void }) {
  const [open, setOpen] = useState(false);
  return (
    <details
      class="next"
      open={open}
      onToggle={(event) => {
        setOpen(event.currentTarget.open);
        if (!event.currentTarget.open) onChange([]);
      }}
    >
      <summary class="dim">
        {words.dials}
        {!open && `: ${words.dialsStay}`}
      </summary>
      {open && <OpenDials live={live} usual={usual} onChange={onChange} />}
    </details>
  );
}

function OpenDials({ live, usual, onChange }: { live: Live; usual: Series; onChange: (e: Exposure[]) => void }) {
  const { camera, problem } = useCamera(live);
  // What is chosen outlives the moments in which the camera cannot be asked.
  const [offered, setOffered] = useState<Camera["offered"] | null>(null);
  const [chosen, setChosen] = useState<Chosen | null>(null);
  const [dial, setDial] = useState<Dial | "none">(usual.climbs ? "shutter_s" : "none");
  const [steps, setSteps] = useState("");
  const tell = (offered: Camera["offered"], chosen: Chosen, dial: Dial | "none", steps: string) => {
    const from = complete(chosen);
    const places = { shutter_s: offered.shutters_s, aperture: offered.apertures, iso: offered.isos };
    const wanted = Math.min(30, Math.max(1, Math.round(Number(steps) || usual.steps)));
    onChange(from === null ? [] : dial === "none" ? [from] : ladder(from, dial, places[dial], usual.stops, wanted));
    setOffered(offered);
    setChosen(chosen);
    setDial(dial);
    setSteps(steps);
  };
  useEffect(() => {
    // Where the camera stands when it first answers; from then on as chosen.
    if (camera && chosen === null) {
      tell(camera.offered, onDials(camera.exposure ?? null, camera.offered), dial, steps);
    }
  }, [camera]);
  if (problem && !offered) return <p class="rejected">{problem}</p>;
  if (!offered || !chosen) return <p class="dim">{common.looking}</p>;
  return (
    <>
      <Dials
        legend={words.dials}
        quiet
        offered={offered}
        chosen={chosen}
        onChange={(next) => tell(offered, next, dial, steps)}
      />
      {usual.climbs && (
        <div class="climb">
          <label>
            {words.climb}
            <select
              value={dial}
              onChange={(event) => tell(offered, chosen, event.currentTarget.value as Dial | "none", steps)}
            >
              {Object.entries(words.climbs).map(([name, label]) => (
                <option key={name} value={name}>
                  {label}
                </option>
              ))}
            </select>
          </label>
          {dial !== "none" && (
            <Field
              whole
              label={words.steps}
              value={steps}
              hint={usual.steps}
              least={1}
              most={30}
              free
              onChange={(next) => tell(offered, chosen, dial, next)}
            />
          )}
        </div>
      )}
      <p class="dim">{words.dialsBack}</p>
    </>
  );
}

const RAWS = ".cr2,.cr3,.nef,.arw,.raf,.rw2,.orf,.dng";

function Send({ live, session, kind, take }: Omit<Props, "distance">) {
  const [sending, setSending] = useState(false);
  const send = async (field: HTMLInputElement) => {
    const files = [...(field.files ?? [])];
    if (files.length === 0) return;
    setSending(true);
    await live.attempt(calibrations.send(session, kind, take.role, files));
    field.value = "";
    setSending(false);
  };
  return (
    <label>
      <span class="dim">{sending ? words.sending : words.send}</span>
      <input
        type="file"
        multiple
        disabled={sending}
        accept={RAWS}
        onChange={(event) => void send(event.currentTarget)}
      />
    </label>
  );
}

/** Card shots as files: lit ones, and those without flash that belong to them. */
function SendCards({ live, session, take, distance }: Omit<Props, "kind">) {
  const [sending, setSending] = useState(false);
  const send = async (form: HTMLFormElement) => {
    const files = (name: string) => byName((form.elements.namedItem(name) as HTMLInputElement).files ?? []);
    const [lit, off] = [files("lit"), files("off")];
    if (lit.length === 0) return;
    setSending(true);
    const work = async () => {
      if (off.length > 1 && off.length !== lit.length) throw new Error(words.unequal(lit.length, off.length));
      const place = distance === "" ? undefined : Number(distance);
      // One by one: each is a shot of its own.
      for (const [i, file] of lit.entries()) {
        await calibrations.send(session, "flash", take.role, [file], place, off[i] ?? off[0]);
      }
      form.reset();
    };
    await live.attempt(work());
    setSending(false);
  };
  return (
    <form
      class="cards"
      onSubmit={(event) => {
        event.preventDefault();
        void send(event.currentTarget);
      }}
    >
      <label>
        <span class="dim">{words.sendCards}</span>
        <input type="file" name="lit" multiple required disabled={sending} accept={RAWS} />
      </label>
      <label>
        <span class="dim">{words.sendOffs}</span>
        <input type="file" name="off" multiple disabled={sending} accept={RAWS} />
      </label>
      <button type="submit" class="quiet" disabled={sending}>
        {sending ? words.sending : words.sendThem}
      </button>
    </form>
  );
}
