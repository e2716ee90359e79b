// What the camera says of itself, asked again when it may have changed.

import { useCallback, useEffect, useRef, useState } from "preact/hooks";
import { api, type Camera, type Exposure, type Job } from "./api";
import type { Live } from "./live";

export interface CameraSaid {
  camera: Camera | null;
  /** Why it could not be asked, in words. */
  problem: string | null;
  asking: boolean;
  askAgain: () => void;
}

/** Whether two labels mean the same place of a dial: neighbours are a third of a stop apart. */
export function sameLabel(a: number, b: number): boolean {
  return Math.abs(Math.log2(a / b)) < 0.1;
}

export function sameExposure(a: Exposure, b: Exposure): boolean {
  return sameLabel(a.shutter_s, b.shutter_s) && sameLabel(a.aperture, b.aperture) && sameLabel(a.iso, b.iso);
}

/** An accepted pair has proved by its files how the camera stands. */
function proved(job: Job | undefined): boolean {
  const result = job?.result as { verdict?: string } | null | undefined;
  return job?.kind === "pair" && job.state === "done" && result?.verdict === "accepted";
}

export function useCamera(live: Live): CameraSaid {
  const [camera, setCamera] = useState<Camera | null>(null);
  const [problem, setProblem] = useState<string | null>(null);
  const [asking, setAsking] = useState(false);
  const [count, setCount] = useState(0);
  const answered = useRef("");

  const device = live.state?.devices.camera;
  const plan = live.session?.exposure ?? null;
  const busy = live.rigJob !== null;
  const about = [device?.description, live.session?.name, plan?.words, count].join("\n");
  const lastJob = live.jobs.find((job) => job.kind === "pair");

  useEffect(() => {
    if (!device?.ready) {
      setCamera(null);
      answered.current = "";
      return;
    }
    // The camera belongs to whoever shoots.
    if (busy) return;
    const asPlanned = plan && camera?.exposure && sameExposure(camera.exposure, plan.on);
    if (answered.current === about && asPlanned && proved(lastJob)) return;
    let late = false;
    setAsking(true);
    api
      .camera()
      .then(
        (said) => {
          if (late) return;
          answered.current = about;
          setCamera(said);
          setProblem(null);
        },
        (error: unknown) => {
          if (!late) setProblem(error instanceof Error ? error.message : String(error));
        },
      )
      .finally(() => {
        if (!late) setAsking(false);
      });
    return () => {
      late = true;
      setAsking(false);
    };
  }, [device?.ready, about, busy]);

  const askAgain = useCallback(() => setCount((n) => n + 1), []);
  return { camera, problem, asking, askAgain };
}
