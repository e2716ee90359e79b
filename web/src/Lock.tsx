import { api, type LockItem } from "./api";
import type { Live } from "./live";
import { counted, words } from "./words";

/** The exposure lock: what is wrong, what to think of, what to look at by eye, and what stands as it should. */
export function Lock({ live, items }: { live: Live; items: LockItem[] }) {
  const session = live.session;
  const confirmed = session?.confirmed ?? [];
  const wrong = items.filter((item) => item.state === "wrong");
  const warnings = items.filter((item) => item.state === "warning");
  const unseen = items.filter((item) => item.state === "unreadable" && !confirmed.includes(item.name));
  const good = items.filter(
    (item) => item.state === "locked" || item.state === "corrected" || confirmed.includes(item.name),
  );
  if (items.length === 0) return <p class="dim">{words.lockUnknown}</p>;
  return (
    <div class="lock">
      {wrong.length > 0 && (
        <div class="wrong" role="alert">
          <h3>{words.lockWrong}</h3>
          <Sentences items={wrong} />
        </div>
      )}
      {warnings.length > 0 && (
        <div class="warns">
          <h3>{words.lockWarns}</h3>
          <Sentences items={warnings} />
        </div>
      )}
      {unseen.length > 0 && (
        <div class="unseen-by-camera">
          <h3>{words.lockUnreadable}</h3>
          <ul>
            {unseen.map((item) => (
              <li key={item.name}>
                <p>{item.sentence}</p>
                <button
                  type="button"
                  disabled={!session}
                  onClick={() => session && void live.attempt(api.confirmSettings(session.name, [item.name]))}
                >
                  {words.checked}
                </button>
              </li>
            ))}
          </ul>
          {!session && <p class="dim">{words.checkedNeedsSession}</p>}
        </div>
      )}
      {good.length > 0 && (
        <details>
          <summary>{words.lockGood(counted(good.length, "setting", "settings"))}</summary>
          <ul class="good">
            {good.map((item) => (
              <li key={item.name}>
                {item.state === "unreadable" ? words.checkedByEye(item.sentence) : item.sentence}
              </li>
            ))}
          </ul>
        </details>
      )}
    </div>
  );
}

function Sentences({ items }: { items: LockItem[] }) {
  return (
    <ul>
      {items.map((item) => (
        <li key={item.name}>{item.sentence}</li>
      ))}
    </ul>
  );
}
