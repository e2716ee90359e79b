import type { Reason } from "./api";
import { words } from "./words";

/** What is wrong with a pair; the figures behind each sentence come out on a click. */
export function Reasons({ reasons }: { reasons: Reason[] }) {
  return (
    <>
      {reasons.map((reason) => (
        <details class="reason" key={reason.code + reason.sentence}>
          <summary>{reason.sentence}</summary>
          <p class="dim">{words.figure(reason)}</p>
        </details>
      ))}
    </>
  );
}
