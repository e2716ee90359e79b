import { useEffect, useState } from "preact/hooks";
import { api, type DeviceState, type ListedCamera } from "./api";
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
      <CameraChoice live={live} />
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

/** Shown only when there is a choice. */
function CameraChoice({ live }: { live: Live }) {
  const [cameras, setCameras] = useState<ListedCamera[]>([]);
  const camera = live.state?.devices.camera;
  const busy = live.rigJob !== null;
  const { attempt } = live;
  useEffect(() => {
    if (!camera || busy) return;
    let late = false;
    // What keeps the list from being read is told by the device line already.
    api.cameras().then(
      (listed) => !late && setCameras(listed),
      () => !late && setCameras([]),
    );
    return () => {
      late = true;
    };
  }, [camera?.description, camera?.words]);

  if (cameras.length < 2) return null;
  const choose = async (port: string) => {
    if (await attempt(api.chooseCamera(port))) {
      setCameras(cameras.map((listed) => ({ ...listed, in_use: listed.port === port })));
    }
  };
  const inUse = cameras.find((listed) => listed.in_use)?.port ?? "";
  return (
    <label class="choice">
      <span class="dim">{words.cameraInUse}</span>
      <select value={inUse} disabled={busy} onChange={(event) => void choose(event.currentTarget.value)}>
        {inUse === "" && <option value="">{words.noCameraInUse}</option>}
        {cameras.map((listed) => (
          <option key={listed.port} value={listed.port}>
            {listed.model}, {listed.port}
          </option>
        ))}
      </select>
    </label>
  );
}
