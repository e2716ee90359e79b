import type { Kind } from "./calibration";
import { calibrationWords as words } from "./calibrationWords";

/** How the rig is set up, seen from the side. */
export function Drawing({ kind }: { kind: Kind }) {
  return (
    <svg class="drawing" viewBox="0 0 240 120" role="img" aria-label={words.drawings[kind]}>
      {["noise", "exposure", "steadiness"].includes(kind) && <path d="M52 76 40 112M52 76v36M52 76l12 36" />}
      <g transform={kind === "flat" ? "rotate(90 52 58)" : undefined}>
        <rect x="24" y="40" width="48" height="36" rx="5" />
        <rect x="72" y="47" width="20" height="22" rx="3" />
        <path d="M36 40v-7h18v7" />
        {kind === "levels" && <rect class="lit" x="94" y="44" width="6" height="28" rx="2" />}
        {kind === "exposure" && <path class="lit" d="M34 26a12 12 0 0 1 22 0m0-7v7h-7" />}
      </g>
      {kind === "flat" && <path class="lit" d="M20 30a42 42 0 0 1 30-20m-8-3 8 3-5 7" />}
      {["flash", "steadiness", "colour"].includes(kind) && (
        <>
          <rect class="lit" x="94" y="34" width="7" height="48" rx="3" />
          <path class="light" d="M104 44 190 28M104 58h84M104 72l86 16" />
        </>
      )}
      {kind === "colour" ? (
        <g class="patches">
          {Array.from({ length: 12 }, (_, i) => (
            <rect key={i} x={192 + (i % 2) * 14} y={20 + Math.floor(i / 2) * 14} width="11" height="11" />
          ))}
        </g>
      ) : (
        <rect class={kind === "flash" ? "card" : "card even"} x="196" y="16" width="10" height="84" rx="2" />
      )}
      {kind === "flash" && <path class="lit" d="M92 108h104m-98-4-6 4 6 4m92-8 6 4-6 4" />}
      {["levels", "noise", "exposure", "flat"].includes(kind) && (
        <>
          <circle class="lit" cx="146" cy="18" r="7" />
          <path class="light" d="m154 24 34 18m-40-14 40 50" />
        </>
      )}
    </svg>
  );
}
