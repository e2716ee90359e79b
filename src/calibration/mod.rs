//! Fits from calibration shots; plain inputs.
