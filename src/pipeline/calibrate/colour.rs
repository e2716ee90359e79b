//! Colour of a session, from a frame of a chart.
