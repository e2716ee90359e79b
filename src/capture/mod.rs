//! The pair's state machine; sole owner of the rig.
