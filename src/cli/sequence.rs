//! `unlit shoot --positions N`: a sequence from the terminal, by the same conductor as the daemon's.

use super::shoot::MIRROR_PATIENCE;
use super::{CliError, CliResult, Exit};
use crate::capture::{
    AfterPair, Alone, Conductor, Engine, Events, PairWish, SequenceError, SequenceEvent, SequenceState,
    SequenceView, Topic,
};
use crate::pair::Verdict;
use crate::progress::Progress;
use crate::session::{Between, SequencePlan, Session};
use indicatif::ProgressBar;
use std::path::PathBuf;
use std::sync::Arc;
use std::sync::mpsc::{self, Receiver, Sender};
use tokio::signal::unix::{SignalKind, signal};

#[derive(clap::Args)]
pub(super) struct SequenceArgs {
    /// Shoots this many positions, each until its pair is good; the same command goes on at the first that is missing.
    #[arg(long, value_name = "N", conflicts_with_all = ["pairs", "again"])]
    positions: Option<u32>,
    /// What each position waits for: the return key, some seconds, or a file that a script makes and that is removed
    /// when the position is done (without PATH: `trigger` in the session).
    #[arg(
        long, value_name = "prompt|countdown:SECONDS|file[:PATH]", requires = "positions", default_value = "prompt",
        value_parser = Go::parse
    )]
    between: Go,
    /// Seconds that pass at least from the beginning of a pair to that of the next.
    #[arg(long, value_name = "SECONDS", requires = "positions", default_value_t = 0.0)]
    interval: f64,
    /// How often a rejected pair is taken again before you are asked.
    #[arg(long, value_name = "N", requires = "positions", default_value_t = 0)]
    retries: u32,
    /// Forgets a sequence that was begun or done before; its pairs stay.
    #[arg(long, requires = "positions")]
    anew: bool,
}

/// What a position waits for, and the file if it is one of the user's own.
#[derive(Clone, Debug, PartialEq)]
struct Go(Between, Option<PathBuf>);

impl Go {
    fn parse(text: &str) -> Result<Go, String> {
        let (kind, value) = text.split_once(':').map_or((text, None), |(kind, value)| (kind, Some(value)));
        match (kind, value) {
            ("prompt", None) => Ok(Go(Between::Prompt, None)),
            ("file", None) => Ok(Go(Between::TriggerFile, None)),
            ("file", Some(path)) if !path.is_empty() => Ok(Go(Between::TriggerFile, Some(path.into()))),
            ("countdown", Some(seconds)) => match seconds.parse() {
                Ok(seconds) => Ok(Go(Between::Countdown { seconds }, None)),
                Err(_) => Err(format!("{seconds:?} is no number of seconds")),
            },
            _ => Err("give prompt, countdown:SECONDS, file or file:PATH".into()),
        }
    }
}

impl SequenceArgs {
    /// The plan, if a sequence is wanted; its pairs as `wish` has them.
    pub(super) fn plan(&self, wish: PairWish) -> Option<SequencePlan> {
        let usual = SequencePlan::new(self.positions?, self.between.0);
        Some(SequencePlan {
            interval_s: self.interval,
            retries: self.retries,
            order: wish.order.unwrap_or(usual.order),
            off_frames: wish.off_frames.unwrap_or(usual.off_frames),
            ..usual
        })
    }
}

/// What the terminal waits for.
enum Told {
    /// The sequence came on.
    Stands,
    /// A line was typed; `None` at the end of input.
    Line(Option<String>),
    /// Ctrl-C.
    Interrupted,
}

/// Who takes the pairs, and how they are shown.
pub(super) struct Crew {
    pub(super) engine: Arc<Engine>,
    pub(super) operator: Option<AfterPair>,
    pub(super) events: Events,
    pub(super) progress: Progress,
    pub(super) bar: ProgressBar,
}

/// Shoots the plan, or what is missing of it.
pub(super) fn walk(args: &SequenceArgs, plan: SequencePlan, session: Session, crew: Crew) -> CliResult {
    let Crew { engine, operator, events, progress, bar } = crew;
    let (tell, told) = mpsc::channel();
    listen(&events, tell.clone())?;
    let trigger = args.between.1.clone().unwrap_or_else(|| session.trigger_file());
    let shooter = Box::new(Alone::new(engine, operator, progress.clone()));
    let session = Arc::new(session);
    let conductor = Conductor::open(session.clone(), shooter, events, trigger).map_err(CliError::new)?;
    let begun = begin(&conductor, args, plan);
    let outcome = begun.and_then(|()| attend(&conductor, &told, &tell, &bar));
    match &outcome {
        Ok(view) => {
            let words = summary(view, &session)?;
            bar.suspend(|| println!("{words}"));
        }
        Err(_) => {
            // A sequence that is over, or whose pair ends by itself, needs no stopping.
            let _at_rest = conductor.wish(SequenceEvent::Pause, None);
            progress.cancel();
            rest(&conductor, &told);
        }
    }
    if let Some(mirror) = session.finish_mirror(MIRROR_PATIENCE) {
        bar.suspend(|| println!("{}", mirror.words()));
    }
    bar.finish_and_clear();
    outcome.map(|_| Exit::Success)
}

/// Begins the plan, or goes on with it. One that is done stays so: it is begun anew only where that is asked for.
fn begin(conductor: &Arc<Conductor>, args: &SequenceArgs, plan: SequencePlan) -> Result<(), CliError> {
    match conductor.view() {
        Ok(_) if args.anew => conductor.forget().map_err(CliError::new)?,
        Ok(view) if view.state == SequenceState::Done && view.plan.positions == plan.positions => {
            return Ok(());
        }
        Ok(view) if matches!(view.state, SequenceState::Done | SequenceState::Cancelled) => {
            return Err(CliError::new(format!(
                "the session has a sequence that is over: {} Add --anew",
                view.words
            )));
        }
        _ => {}
    }
    conductor.plan(plan).map_err(|error| match error {
        SequenceError::Unfinished { .. } => CliError::new(format!("{error}: add --anew")),
        other => CliError::new(other),
    })?;
    conductor.go_on().map_err(CliError::new)?;
    Ok(())
}

/// What came of a sequence that is done.
fn summary(view: &SequenceView, session: &Session) -> Result<String, CliError> {
    let attempts = session.attempts().map_err(CliError::new)?;
    let own = view.positions.iter().flat_map(|place| &place.pairs);
    let taken = own.filter_map(|pair| attempts.get(pair)).flatten();
    let rejected = taken.filter(|attempt| attempt.verdict == Verdict::Rejected).count();
    let SequenceView { done, skipped, .. } = view;
    Ok(format!(
        "Pairs: {done} accepted, {rejected} rejected; positions skipped: {skipped}. --anew begins another sequence."
    ))
}

/// Shows how the sequence stands, and passes on what is typed, until it is done.
fn attend(
    conductor: &Arc<Conductor>,
    told: &Receiver<Told>,
    tell: &Sender<Told>,
    bar: &ProgressBar,
) -> Result<SequenceView, CliError> {
    let (mut shown, mut reading) = (String::new(), false);
    let say = |words: &str| bar.suspend(|| println!("{words}"));
    while let Ok(news) = told.recv() {
        let view = conductor.view().map_err(CliError::new)?;
        match news {
            Told::Interrupted => return Err(interrupted(&view)),
            Told::Line(None) => return Err(CliError::new("nobody is there to answer (end of input)")),
            Told::Line(Some(line)) => {
                reading = false;
                shown.clear();
                let wish = match (view.state, line.trim()) {
                    (SequenceState::Waiting, _) => SequenceEvent::Next,
                    (SequenceState::Asking, "s" | "skip") => SequenceEvent::Skip,
                    (SequenceState::Asking, "" | "r" | "retry") => SequenceEvent::Retry,
                    _ => {
                        tell.send(Told::Stands).map_err(CliError::new)?;
                        continue;
                    }
                };
                conductor.wish(wish, view.position).map_err(CliError::new)?;
            }
            Told::Stands => {
                bar.set_prefix(format!(
                    "{}/{}",
                    view.position.unwrap_or(view.plan.positions),
                    view.plan.positions
                ));
                if view.state != SequenceState::Shooting {
                    // Else the bar below the instruction still tells of the pair before.
                    bar.set_position(0);
                    bar.set_message("");
                }
                let (words, asks) = line(&view);
                if words != shown {
                    say(&words);
                    shown = words;
                }
                if asks && !reading {
                    reading = true;
                    read_line(tell.clone())?;
                }
                match view.state {
                    SequenceState::Done => return Ok(view),
                    SequenceState::Paused | SequenceState::Cancelled => {
                        return Err(CliError::new(view.words));
                    }
                    _ => {}
                }
            }
        }
    }
    Err(CliError::new("the sequence is not told of any more"))
}

/// What the terminal says, and whether it waits for the keyboard.
fn line(view: &SequenceView) -> (String, bool) {
    let guide = view.guide.as_deref().unwrap_or_default();
    match (view.state, view.plan.between) {
        (SequenceState::Waiting, Between::Prompt) => (format!("{guide} [return]"), true),
        (SequenceState::Asking, _) => (format!("{} [return: again, s: skip]", view.words), true),
        _ => (view.words.clone(), false),
    }
}

fn interrupted(view: &SequenceView) -> CliError {
    let (position, positions) = (view.position.unwrap_or(view.plan.positions), view.plan.positions);
    CliError::new(format!("stopped at position {position} of {positions}; the same command goes on there"))
}

/// Waits for the pair that is being taken to end, unless ctrl-C comes again.
fn rest(conductor: &Conductor, told: &Receiver<Told>) {
    while conductor.view().is_ok_and(|view| view.state == SequenceState::Shooting) {
        if let Ok(Told::Interrupted) | Err(_) = told.recv() {
            return;
        }
    }
}

/// Tells of the sequence's events and of ctrl-C.
fn listen(events: &Events, tell: Sender<Told>) -> Result<(), CliError> {
    let (_, mut heard) = events.listen();
    let interrupted = tell.clone();
    let hearing = move || {
        use tokio::sync::broadcast::error::RecvError::Lagged;
        loop {
            let stands = match heard.blocking_recv() {
                Ok(event) => event.topic == Topic::Sequence,
                Err(Lagged(_)) => true,
                Err(_) => return,
            };
            if stands && tell.send(Told::Stands).is_err() {
                return;
            }
        }
    };
    std::thread::Builder::new().name("sequence-news".into()).spawn(hearing).map_err(CliError::new)?;
    let runtime =
        tokio::runtime::Builder::new_current_thread().enable_all().build().map_err(CliError::new)?;
    let (mut interrupt, mut terminate) = {
        let _inside = runtime.enter();
        let of = |kind| signal(kind).map_err(CliError::new);
        (of(SignalKind::interrupt())?, of(SignalKind::terminate())?)
    };
    let waiting = move || {
        loop {
            runtime.block_on(async {
                tokio::select! {
                    _ = interrupt.recv() => {}
                    _ = terminate.recv() => {}
                }
            });
            if interrupted.send(Told::Interrupted).is_err() {
                return;
            }
        }
    };
    std::thread::Builder::new().name("interrupts".into()).spawn(waiting).map_err(CliError::new)?;
    Ok(())
}

/// Reads one line on a thread of its own, so that ctrl-C is heard meanwhile.
fn read_line(tell: Sender<Told>) -> Result<(), CliError> {
    let reading = move || {
        let mut line = String::new();
        let read = std::io::stdin().read_line(&mut line);
        // Nobody listens any more once the sequence is over.
        let _over = tell.send(Told::Line(read.is_ok_and(|n| n > 0).then_some(line)));
    };
    std::thread::Builder::new().name("keyboard".into()).spawn(reading).map_err(CliError::new)?;
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_a_position_waits_for_is_read_from_the_command_line() {
        assert_eq!(Go::parse("prompt"), Ok(Go(Between::Prompt, None)));
        assert_eq!(Go::parse("countdown:2.5"), Ok(Go(Between::Countdown { seconds: 2.5 }, None)));
        assert_eq!(Go::parse("file"), Ok(Go(Between::TriggerFile, None)));
        assert_eq!(Go::parse("file:/run/a:b"), Ok(Go(Between::TriggerFile, Some("/run/a:b".into()))));
        for wrong in ["", "hook", "countdown", "countdown:soon", "file:", "prompt:1"] {
            assert!(Go::parse(wrong).is_err(), "{wrong:?} was taken");
        }
    }
}
