import { useRef, useState } from "preact/hooks";
import { api, type Session } from "./api";
import type { Live } from "./live";
import { counted, words } from "./words";

export function SessionMenu({ live }: { live: Live }) {
  const [others, setOthers] = useState<Session[]>([]);
  const [name, setName] = useState("");
  const menu = useRef<HTMLDetailsElement>(null);

  const opened = async () => {
    if (!menu.current?.open) return;
    const all = await live.attempt(api.sessions());
    if (all) setOthers(all.filter((session) => !session.current));
  };
  const go = async (chosen: string) => {
    if (await live.attempt(api.openSession(chosen))) {
      setName("");
      if (menu.current) menu.current.open = false;
    }
  };

  return (
    <details class="session" ref={menu} onToggle={() => void opened()}>
      <summary>
        <span class="dim">{words.session}</span> {live.state?.session ?? words.noSession}
      </summary>
      <div class="menu">
        <form
          onSubmit={(event) => {
            event.preventDefault();
            void go(name.trim());
          }}
        >
          <label>
            {words.newSession}
            <input
              value={name}
              required
              maxLength={80}
              placeholder={words.newSessionName}
              onInput={(event) => setName(event.currentTarget.value)}
            />
          </label>
          <button type="submit">{words.create}</button>
        </form>
        {others.length > 0 && (
          <>
            <h2>{words.otherSession}</h2>
            <ul>
              {others.map((session) => (
                <li key={session.name}>
                  <button type="button" class="quiet" onClick={() => void go(session.name)}>
                    {session.name} <span class="dim">{counted(session.pairs, "pair", "pairs")}</span>
                  </button>
                </li>
              ))}
            </ul>
          </>
        )}
      </div>
    </details>
  );
}
