import { useState } from "preact/hooks";
import { calibrations } from "./calibration";
import type { Props } from "./CalibrationGuide";
import { calibrationWords as words } from "./calibrationWords";
import { Field } from "./Field";

/** "812,1034 2210,1040 ..." as points; null where nothing is given. */
const points = (text: string) => {
  const given = text.trim().split(/\s+/).filter((point) => point !== "");
  return given.length === 0 ? null : given.map((point) => point.split(",").map(Number));
};

/** The few things that must be said, and the button. */
export function Fit({ live, session, state, heldOut, busy }: Props & { heldOut: string[]; busy: boolean }) {
  const { kind, shots, measured } = state;
  const [stops, setStops] = useState("");
  const [chart, setChart] = useState("");
  const [reflectance, setReflectance] = useState("");
  const [inner, setInner] = useState("");
  const [outer, setOuter] = useState("");
  const [focal, setFocal] = useState("");
  const [fitRadii, setFitRadii] = useState(false);
  const [tagSize, setTagSize] = useState("");
  const [oneShot, setOneShot] = useState("");
  const [corners, setCorners] = useState("");
  const given = (text: string) => (text.trim() === "" ? null : Number(text));
  const order = () => {
    switch (kind) {
      case "noise":
        return { stops: given(stops) };
      case "colour":
        return { chart: chart === "" ? null : chart, corners_px: points(corners) };
      case "flash": {
        const size = given(tagSize);
        const card = {
          target_reflectance: given(reflectance),
          focal_px: given(focal),
          tag_size_m: size === null ? null : size / 1000,
        };
        if (oneShot !== "") return { ...card, one_shot: oneShot };
        const ring_radii = [Number(inner) / 1000, Number(outer) / 1000];
        return { ...card, ring_radii, fit_radii: fitRadii, held_out: heldOut };
      }
      default:
        return {};
    }
  };
  return (
    <form
      onSubmit={(event) => {
        event.preventDefault();
        void live.attempt(calibrations.fit(session, kind, order()));
      }}
    >
      {kind === "noise" && <Field label={words.stops} value={stops} least={0.01} most={10} onChange={setStops} free />}
      {kind === "colour" && (
        <label>
          {words.chart}
          <select value={chart} onChange={(event) => setChart(event.currentTarget.value)}>
            <option value="">{words.anyChart}</option>
            {Object.entries(words.charts).map(([name, label]) => (
              <option key={name} value={name}>
                {label}
              </option>
            ))}
          </select>
        </label>
      )}
      {kind === "colour" && (
        <details class="more">
          <summary class="dim">{words.more}</summary>
          <label>
            {words.corners}
            <input
              type="text"
              inputMode="numeric"
              pattern={"\\s*([0-9.]+,[0-9.]+\\s+){3}[0-9.]+,[0-9.]+\\s*"}
              value={corners}
              onInput={(event) => setCorners(event.currentTarget.value)}
            />
          </label>
        </details>
      )}
      {kind === "flash" && (
        <>
          <Field label={words.reflectance} value={reflectance} least={0.01} most={1} onChange={setReflectance} free />
          {oneShot === "" && (
            <>
              <Field label={words.innerRadius} value={inner} least={0} most={999} onChange={setInner} />
              <Field label={words.outerRadius} value={outer} least={0.1} most={999} onChange={setOuter} />
            </>
          )}
          <Field label={words.focal} value={focal} least={1} most={1e6} onChange={setFocal} free />
          <details class="more">
            <summary class="dim">{words.more}</summary>
            <Field label={words.tagSize} value={tagSize} least={0.1} most={9999} onChange={setTagSize} free />
            {oneShot === "" && (
              <label class="check">
                <input
                  type="checkbox"
                  checked={fitRadii}
                  onChange={(event) => setFitRadii(event.currentTarget.checked)}
                />
                {words.fitRadii}
              </label>
            )}
            {measured && (
              <label>
                {words.oneShot}
                <select value={oneShot} onChange={(event) => setOneShot(event.currentTarget.value)}>
                  <option value="">{words.noOneShot}</option>
                  {shots
                    .filter((shot) => shot.reasons.length === 0)
                    .map((shot) => (
                      <option key={shot.id} value={shot.id}>
                        {shot.id}
                      </option>
                    ))}
                </select>
              </label>
            )}
          </details>
        </>
      )}
      <button type="submit" disabled={busy || shots.length === 0}>
        {measured ? words.fitAgain : words.fit}
      </button>
    </form>
  );
}
