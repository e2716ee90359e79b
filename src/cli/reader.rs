//! A reader that goes away: `unlit ... | head`.

use std::any::Any;
use std::panic::{UnwindSafe, catch_unwind, resume_unwind, set_hook, take_hook};
use std::process::ExitCode;

/// Exit code of a program whose reader went away, as shells tell it for those that SIGPIPE (13) ends.
const READER_GONE: u8 = 128 + 13;

/// Runs the program. When whoever reads its output goes away, it ends without a word: unwinding, so that a flash is
/// disarmed and a session closed on the way out as at any other end.
pub fn until_reader_goes(run: impl FnOnce() -> ExitCode + UnwindSafe) -> ExitCode {
    let usual = take_hook();
    set_hook(Box::new(move |panic| {
        if !is_reader_gone(panic.payload()) {
            usual(panic);
        }
    }));
    catch_unwind(run).unwrap_or_else(|panic| {
        if is_reader_gone(&*panic) {
            return READER_GONE.into();
        }
        resume_unwind(panic)
    })
}

/// What `println!` panics with when standard output is a pipe that nobody reads any more.
fn is_reader_gone(panic: &(dyn Any + Send)) -> bool {
    let said = panic.downcast_ref::<String>();
    said.is_some_and(|said| said.starts_with("failed printing to stdout") && said.contains("os error 32"))
}
