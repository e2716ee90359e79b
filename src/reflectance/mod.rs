//! Weighted least squares per surface point, iterated with the bounces.
