//! Why a wish about a sequence was not taken.

use crate::session::SessionError;

/// Why a wish about a sequence was not taken.
#[derive(Debug, thiserror::Error)]
pub enum SequenceError {
    /// Nothing is planned.
    #[error("session {0:?} has no sequence; plan one first")]
    NotPlanned(String),
    /// The plan makes no sense.
    #[error("{0}")]
    BadPlan(String),
    /// The wish does not fit how the sequence stands.
    #[error("the sequence cannot {wish} now: {stands}")]
    Refused {
        /// What was wanted.
        wish: &'static str,
        /// How it stands, in words.
        stands: String,
    },
    /// The wish was about another position.
    #[error("the word is about position {asked}, but {stands}")]
    Elsewhere {
        /// The position asked for.
        asked: u32,
        /// Where the sequence is, in words.
        stands: String,
    },
    /// A plan of another number of positions, while some are done.
    #[error(
        "{done} of {positions} positions of the sequence before are done; a plan of {positions} positions goes on with it, and removing it first begins anew (its pairs stay)"
    )]
    Unfinished {
        /// Positions that are settled.
        done: u32,
        /// Positions in all.
        positions: u32,
    },
    /// The session folder.
    #[error(transparent)]
    Session(#[from] SessionError),
}
