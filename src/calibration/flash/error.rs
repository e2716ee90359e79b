//! Why a flash could not be fitted.

/// Why no calibration came out.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum FlashFitError {
    /// Reflectance outside (0, 1].
    #[error(
        "target reflectance {0} is not possible: give the card's diffuse reflectance between 0 and 1, for example 0.94"
    )]
    Reflectance(f64),
    /// A curve that is none.
    #[error(
        "the target's curve is not possible: give angles in radians, rising, from 0 to below pi / 2, each with a factor above 0"
    )]
    Curve,
    /// A distance that cannot be.
    #[error(
        "{label}: distance {distance} m is not possible: give metres from the lens to the card, greater than 0"
    )]
    Distance {
        /// File.
        label: String,
        /// What was given.
        distance: f64,
    },
    /// A plane that cannot be.
    #[error(
        "{label}: the card does not face the camera: give a unit normal that points from the card to the camera, at most 80 degrees off the axis"
    )]
    Plane {
        /// File.
        label: String,
    },
    /// Sizes differ.
    #[error(
        "{label} is {got:?} sites but the camera model is {expected:?}: all shots must be full frames of the camera that took the photos"
    )]
    Size {
        /// File.
        label: String,
        /// Width and height of the shot.
        got: (usize, usize),
        /// Width and height of the camera model.
        expected: (usize, usize),
    },
    /// The shots are not of a card at these distances.
    #[error(
        "the card shots are off the model by {0:.0} %: does the card fill the frame and face the camera, and are the distances and ring radii in metres?"
    )]
    Residual(f64),
    /// The search found no end.
    #[error(
        "no ring flash of these radii explains the card shots: check distances and radii (metres), and shoot the card at two distances or more"
    )]
    Vague,
    /// Nothing usable.
    #[error(
        "no card shot has light to measure ({0}); shoot the card farther away if it is over-exposed, or check that the flash fired"
    )]
    Nothing(String),
}
