import { useState } from "preact/hooks";
import { api, type Lighting as Told, type Session } from "./api";
import { calibrationWords as words } from "./calibrationWords";
import { Field } from "./Field";
import type { Live } from "./live";

/** What no file tells and the photographer has to: the polariser, and the power of the flash. */
export function Lighting({ live, session }: { live: Live; session: Session }) {
  return (
    <details class="lighting">
      <summary>
        {words.lighting}: <span class="dim">{words.lightingNow(session.lighting)}</span>
      </summary>
      <Telling key={JSON.stringify(session.lighting)} live={live} session={session} />
    </details>
  );
}

function Telling({ live, session }: { live: Live; session: Session }) {
  const { polariser, flash_power } = session.lighting;
  const [through, setThrough] = useState(polariser != null);
  const [angle, setAngle] = useState(polariser?.angle_degrees?.toString() ?? "");
  const [power, setPower] = useState(flash_power?.toString() ?? "");
  const given = (text: string) => (text.trim() === "" ? null : Number(text));
  const told: Told = { polariser: through ? { angle_degrees: given(angle) } : null, flash_power: given(power) };
  return (
    <form
      onSubmit={(event) => {
        event.preventDefault();
        void live.attempt(api.setLighting(session.name, told));
      }}
    >
      <label class="check">
        <input type="checkbox" checked={through} onChange={(event) => setThrough(event.currentTarget.checked)} />
        {words.polariser}
      </label>
      {through && <Field label={words.angle} value={angle} least={-360} most={360} free onChange={setAngle} />}
      <Field label={words.power} value={power} least={0.001} most={1} free onChange={setPower} />
      <button type="submit">{words.set}</button>
    </form>
  );
}
