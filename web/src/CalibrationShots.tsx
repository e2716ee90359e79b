import { calibrations } from "./calibration";
import type { Props } from "./CalibrationGuide";
import { calibrationWords as words } from "./calibrationWords";

interface ShotsProps extends Props {
  /** Ids of those that only check the fit. */
  heldOut: string[];
  onHeldOut: (ids: string[]) => void;
}

/** The shots that the next measurement takes: how each was exposed, and what is wrong with it. */
export function Shots({ live, session, state, heldOut, onHeldOut }: ShotsProps) {
  const { kind, guide, shots } = state;
  const name = (role: string) => guide.takes.find((take) => take.role === role)?.name ?? role;
  return (
    <section aria-label={words.shots}>
      <h3>{words.shots}</h3>
      {shots.length === 0 && <p class="dim">{words.noShots}</p>}
      <ol class="shots" aria-live="polite">
        {shots.map((shot, i) => (
          <li key={shot.id}>
            <span>
              {words.shot(name(shot.role), shot.exposure)}
              {shot.distance_m != null && ` ${words.metres(shot.distance_m)}`}
            </span>
            <span class="dim">
              {shot.mean_share != null && words.mean(Math.max(0, shot.mean_share))}
              {shot.clipped_share != null && shot.clipped_share > 0 && words.clipped(shot.clipped_share)}
              {shot.in_record && words.used}
            </span>
            {!shot.in_record && (
              <button
                type="button"
                class="quiet"
                aria-label={words.removeShot(i + 1, name(shot.role))}
                onClick={() => void live.attempt(calibrations.remove(session, kind, shot.id))}
              >
                {words.remove}
              </button>
            )}
            {shot.mean_share != null && (
              <meter min={0} max={1} value={Math.max(0, shot.mean_share)} aria-label={words.mean(shot.mean_share)} />
            )}
            {[...shot.reasons, ...(shot.fault ? [shot.fault] : [])].map((reason) => (
              <p key={reason} class="rejected">
                {reason}
              </p>
            ))}
            {kind === "flash" && shot.reasons.length === 0 && (
              <label class="check">
                <input
                  type="checkbox"
                  checked={heldOut.includes(shot.id)}
                  onChange={(event) =>
                    onHeldOut([
                      ...heldOut.filter((id) => id !== shot.id),
                      ...(event.currentTarget.checked ? [shot.id] : []),
                    ])
                  }
                />
                {words.checkOnly}
              </label>
            )}
          </li>
        ))}
      </ol>
    </section>
  );
}
