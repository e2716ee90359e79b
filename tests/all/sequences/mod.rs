//! Sequences of positions: over the desk with a rig without wires, over HTTP with a daemon that is killed, and from
//! the terminal.

mod daemon;
mod desk;
mod pairs;
mod terminal;
