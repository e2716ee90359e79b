// The state of the house, kept up to date by server-sent events.

import { useCallback, useEffect, useRef, useState } from "preact/hooks";
import {
  api,
  type Devices,
  type Job,
  type Mirror,
  type Pair,
  type Session,
  type State,
  type Studio,
} from "./api";
import { type Sequence, withSequence } from "./sequence";

export interface Live {
  connected: boolean;
  /** Null until the first snapshot. */
  state: State | null;
  session: Session | null;
  /** Newest first. */
  pairs: Pair[];
  /** Newest first. */
  jobs: Job[];
  /** The job that has the camera, if any. */
  rigJob: Job | null;
  /** What is being done about a device that failed during the work that runs. */
  recovery: string | null;
  troubles: string[];
  /** Grows whenever a calibration or its shots change. */
  calibrated: number;
  /** Runs a call; its error, if any, is shown in words. */
  attempt: <T>(call: Promise<T>) => Promise<T | undefined>;
  dismiss: () => void;
}

/** Jobs that use camera and flash, which only one can at a time. */
const RIG = ["pair", "flash_shots", "calibration_shot", "find_exposure", "repeatability"];

/** How often a second copy that is behind is looked at: that it fails or is in step again is told, how far it is not. */
const BEHIND_MS = 2000;

const isActive = (job: Job) => job.state === "running" || job.state === "queued";

interface Told<T> {
  words: string;
  data: T;
}

export function useLive(): Live {
  const [connected, setConnected] = useState(true);
  const [state, setState] = useState<State | null>(null);
  const [session, setSession] = useState<Session | null>(null);
  const [pairs, setPairs] = useState<Pair[]>([]);
  const [troubles, setTroubles] = useState<string[]>([]);
  const [recovery, setRecovery] = useState<string | null>(null);
  const [calibrated, setCalibrated] = useState(0);
  const current = useRef<string | null>(null);
  // Answers to older questions that come late are dropped.
  const asked = useRef(0);

  const trouble = useCallback((said: string) => {
    setTroubles((before) => [said, ...before.filter((t) => t !== said)].slice(0, 3));
  }, []);

  const attempt = useCallback(
    async <T>(call: Promise<T>): Promise<T | undefined> => {
      try {
        return await call;
      } catch (error) {
        trouble(error instanceof Error ? error.message : String(error));
        return undefined;
      }
    },
    [trouble],
  );

  useEffect(() => {
    const load = async (name: string | null) => {
      if (name !== current.current) {
        setPairs([]);
        setSession(null);
      }
      current.current = name;
      const question = ++asked.current;
      if (name === null) return;
      const [about, taken] = await Promise.all([attempt(api.session(name)), attempt(api.pairs(name))]);
      if (asked.current !== question) return;
      if (about) show(about, question);
      if (taken) setPairs(taken.reverse());
    };
    const show = (about: Session, question: number) => {
      setSession(about);
      if (about.mirror?.state !== "behind") return;
      setTimeout(() => {
        if (asked.current !== question) return;
        void attempt(api.session(about.name)).then((now) => {
          if (now && asked.current === question) show(now, question);
        });
      }, BEHIND_MS);
    };
    const change = (part: Partial<State>) => setState((before) => before && { ...before, ...part });

    const source = new EventSource("/api/v1/events");
    const on = <T>(topic: string, hear: (told: T) => void) =>
      source.addEventListener(topic, (event) => hear(JSON.parse((event as MessageEvent<string>).data) as T));

    source.onopen = () => setConnected(true);
    source.onerror = () => setConnected(false);
    on<State>("state", (snapshot) => {
      setConnected(true);
      setState(snapshot);
      setRecovery(null);
      setCalibrated((n) => n + 1);
      void load(snapshot.session);
    });
    on<Told<Devices>>("devices", (told) => change({ devices: told.data }));
    on<Told<{ session: string | null; changed?: string }>>("session", ({ data }) => {
      change({ session: data.session });
      if (data.session !== current.current || (data.changed ?? data.session) === data.session) {
        void load(data.session);
      }
    });
    on<Told<null>>("recovery", (told) => setRecovery(told.words));
    on<Told<null>>("prompt", (told) => change({ prompt: told.words }));
    on<Told<null>>("prompt_done", () => change({ prompt: null }));
    on<Told<Studio>>("studio", (told) => change({ studio: told.data }));
    on<Told<{ session: string }>>("pair", (told) => {
      if (told.data.session === current.current) void load(told.data.session);
    });
    on<Told<Sequence>>("sequence", ({ data }) =>
      setState((before) => before && { ...before, sequences: withSequence(before.sequences, data) }),
    );
    on<Told<{ session: string; mirror: Mirror }>>("mirror", ({ words, data }) => {
      if (data.session !== current.current) return;
      setSession((before) => before && { ...before, mirror: { state: data.mirror.state, words } });
    });
    for (const topic of ["calibration", "calibration_shot"]) on(topic, () => setCalibrated((n) => n + 1));
    on<Told<null>>("trouble", (told) => trouble(told.words));
    on<Told<Job>>("job", ({ data: job }) => {
      setState(
        (before) => before && { ...before, jobs: [job, ...before.jobs.filter((j) => j.id !== job.id)] },
      );
      if (job.state === "running" && job.kind === "pair") setTroubles([]);
      if (RIG.includes(job.kind) && !isActive(job)) setRecovery(null);
      if (job.state === "done" && job.kind !== "pair" && job.session === current.current) {
        void load(job.session);
      }
    });
    return () => source.close();
  }, [attempt, trouble]);

  const jobs = [...(state?.jobs ?? [])].sort((a, b) => b.id - a.id);
  const rigJob = jobs.find((job) => RIG.includes(job.kind) && isActive(job)) ?? null;
  const dismiss = () => setTroubles([]);
  return { connected, state, session, pairs, jobs, rigJob, recovery, troubles, calibrated, attempt, dismiss };
}
