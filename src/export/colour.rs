//! From camera RGB to colour spaces that other programs know.
//!
//! A reflectance in camera RGB is relative to a white card, so that white is (1, 1, 1) whatever the flash's colour.
//! What is known of the camera is the matrix C from CIE XYZ to its RGB under an illuminant of white w (a DNG's
//! ColorMatrix, see [`CameraColour`]). White stays white when each channel is first scaled by its reading of w:
//! XYZ = C^-1 diag(C w) rho (dcraw and the DNG specification do the same in other words). The white is then adapted to
//! the space's by Bradford's cone responses (ICC.1:2022, annex E), and the space's primaries do the rest.

use crate::codec::raw::colour::CameraColour;
use glam::{DMat3, DVec3};

/// A colour space with three primaries and linear values.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Space {
    /// Name as it is written into files.
    pub name: &'static str,
    /// Chromaticities (x, y) of red, green and blue.
    pub primaries: [[f64; 2]; 3],
    /// Chromaticity of white.
    pub white: [f64; 2],
}

/// IEC 61966-2-1 primaries, linear.
pub const LINEAR_SRGB: Space = Space {
    name: "linear sRGB (IEC 61966-2-1 primaries, D65)",
    primaries: [[0.64, 0.33], [0.30, 0.60], [0.15, 0.06]],
    white: [0.3127, 0.3290],
};

/// SMPTE S-2014-004 (AP1 primaries).
pub const ACESCG: Space = Space {
    name: "ACEScg (AP1 primaries, ACES white)",
    primaries: [[0.713, 0.293], [0.165, 0.830], [0.128, 0.044]],
    white: [0.32168, 0.33767],
};

/// White of ICC's profile connection space, D50, XYZ.
pub const PCS_WHITE: DVec3 = DVec3::new(0.9642, 1.0, 0.8249);

impl Space {
    /// White as XYZ, Y = 1.
    pub fn white_xyz(&self) -> DVec3 {
        xyz(self.white)
    }

    /// XYZ of the space's values, white at its own chromaticity.
    pub fn xyz_from_rgb(&self) -> DMat3 {
        let [r, g, b] = self.primaries.map(xyz);
        let primaries = DMat3::from_cols(r, g, b);
        let gains = primaries.inverse() * self.white_xyz();
        primaries * DMat3::from_diagonal(gains)
    }

    /// Values in this space of another's; white stays white.
    pub fn from_space(&self, other: &Space) -> DMat3 {
        self.xyz_from_rgb().inverse() * adapt(other.white_xyz(), self.white_xyz()) * other.xyz_from_rgb()
    }

    /// Values in this space of XYZ under D50, where white is [`PCS_WHITE`].
    pub fn from_pcs(&self) -> DMat3 {
        self.xyz_from_rgb().inverse() * adapt(PCS_WHITE, self.white_xyz())
    }
}

/// What a maker's matrix says of its camera: what a white reads, green being 1, and XYZ under D50 of camera RGB in which
/// white is (1, 1, 1).
pub fn of_maker(camera: &CameraColour) -> (DVec3, DMat3) {
    let rows = camera.camera_from_xyz.map(DVec3::from);
    let camera_from_xyz = DMat3::from_cols(rows[0], rows[1], rows[2]).transpose();
    let white = xyz(camera.white);
    let read = camera_from_xyz * white;
    let xyz_from_camera = camera_from_xyz.inverse() * DMat3::from_diagonal(read);
    (read / read.y, adapt(white, PCS_WHITE) * xyz_from_camera)
}

/// Bradford's adaptation of XYZ from one white to another.
pub fn adapt(from: DVec3, to: DVec3) -> DMat3 {
    let cones = DMat3::from_cols(
        DVec3::new(0.8951, -0.7502, 0.0389),
        DVec3::new(0.2664, 1.7135, -0.0685),
        DVec3::new(-0.1614, 0.0367, 1.0296),
    );
    cones.inverse() * DMat3::from_diagonal((cones * to) / (cones * from)) * cones
}

fn xyz([x, y]: [f64; 2]) -> DVec3 {
    DVec3::new(x / y, 1.0, (1.0 - x - y) / y)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::codec::raw::colour::ColourSource;

    fn camera(rows: [[f64; 3]; 3], white: [f64; 2]) -> CameraColour {
        CameraColour { camera_from_xyz: rows, white, source: ColourSource::FileTag }
    }

    const XYZ_TO_SRGB: [[f64; 3]; 3] =
        [[3.2405, -1.5371, -0.4985], [-0.9693, 1.8760, 0.0416], [0.0556, -0.2040, 1.0572]];

    #[test]
    fn the_primaries_give_the_published_matrices() {
        let srgb = LINEAR_SRGB.xyz_from_rgb().transpose();
        assert!(srgb.x_axis.abs_diff_eq(DVec3::new(0.4124, 0.3576, 0.1805), 2e-4), "{srgb}");
        assert!(srgb.y_axis.abs_diff_eq(DVec3::new(0.2126, 0.7152, 0.0722), 2e-4), "{srgb}");
        let ap1 = ACESCG.xyz_from_rgb().transpose();
        assert!(ap1.y_axis.abs_diff_eq(DVec3::new(0.27223, 0.67408, 0.05369), 1e-5), "{ap1}");
    }

    #[test]
    fn a_camera_whose_channels_are_srgb_scaled_is_srgb() {
        let mut rows = XYZ_TO_SRGB;
        // A camera's channels differ in sensitivity; the white card took that out of the reflectance.
        for (row, gain) in rows.iter_mut().zip([0.52, 1.0, 0.68]) {
            row.iter_mut().for_each(|v| *v *= gain);
        }
        let (read, xyz_from_camera) = of_maker(&camera(rows, [0.3127, 0.3290]));
        let matrix = LINEAR_SRGB.from_pcs() * xyz_from_camera;
        assert!((read / DVec3::new(0.52, 1.0, 0.68)).abs_diff_eq(DVec3::ONE, 2e-3), "{read}");
        assert!(matrix.abs_diff_eq(DMat3::IDENTITY, 2e-3), "{matrix}");
    }

    #[test]
    fn white_stays_white_in_every_space_and_from_every_illuminant() {
        let rows = [[0.7034, -0.0804, -0.1014], [-0.4420, 1.2564, 0.2058], [-0.0851, 0.1994, 0.5758]];
        assert!((LINEAR_SRGB.from_space(&ACESCG) * DVec3::ONE).abs_diff_eq(DVec3::ONE, 1e-12));
        let round = LINEAR_SRGB.from_space(&ACESCG) * ACESCG.from_space(&LINEAR_SRGB);
        assert!(round.abs_diff_eq(DMat3::IDENTITY, 1e-12));
        for white in [[0.3127, 0.3290], [0.4476, 0.4074], [0.3457, 0.3585]] {
            for space in [LINEAR_SRGB, ACESCG] {
                let matrix = space.from_pcs() * of_maker(&camera(rows, white)).1;
                assert!((matrix * DVec3::ONE).abs_diff_eq(DVec3::ONE, 1e-12), "{} {white:?}", space.name);
            }
        }
    }

    #[test]
    fn adaptation_from_d65_to_d50_is_the_published_one() {
        let adapted = adapt(LINEAR_SRGB.white_xyz(), PCS_WHITE).transpose();
        assert!(adapted.x_axis.abs_diff_eq(DVec3::new(1.0479, 0.0229, -0.0502), 3e-4), "{adapted}");
        assert!(adapted.z_axis.abs_diff_eq(DVec3::new(-0.0092, 0.0151, 0.7519), 5e-4), "{adapted}");
    }
}
