import { useState } from "preact/hooks";
import { api, type DeviceState } from "./api";
import type { Live } from "./live";
import { words } from "./words";

export function Devices({ live }: { live: Live }) {
  const [looking, setLooking] = useState(false);
  const devices = live.state?.devices;
  const look = async () => {
    setLooking(true);
    await live.attempt(api.lookForDevices());
    setLooking(false);
  };
  return (
    <section aria-labelledby="devices">
      <div class="head">
        <h2 id="devices">{words.devices}</h2>
        <button type="button" class="quiet" disabled={looking} onClick={() => void look()}>
          {looking ? words.looking : words.lookAgain}
        </button>
      </div>
      <dl class="devices" aria-live="polite">
        <Device name={words.camera} state={devices?.camera} />
        <Device name={words.flash} state={devices?.flash} />
      </dl>
    </section>
  );
}

function Device({ name, state }: { name: string; state: DeviceState | undefined }) {
  const [device, port] = (state?.description ?? "").split(" on ", 2);
  return (
    <div class={state?.ready ? "ready" : "missing"}>
      <dt>
        <span class="dot" aria-hidden="true" />
        {name}
      </dt>
      <dd>
        {device && <span>{device}</span>}
        {port && <span class="port">{port}</span>}
        <span class="dim">{state?.words ?? words.looking}</span>
      </dd>
    </div>
  );
}
