//! `PATCHES.json`: what is known of patches, and where they are.

use super::CertifyError;
use crate::calibration::colour::{ChartKind, Lab, image_from_corners, measured_corners, xyz};
use crate::export::colour::{LINEAR_SRGB, PCS_WHITE, adapt};
use crate::pipeline::colour::SessionMatrix;
use glam::{DVec2, DVec3};
use serde::{Deserialize, Serialize};
use std::collections::BTreeSet;

/// The file.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PatchList {
    /// Single patches.
    #[serde(default)]
    pub patches: Vec<KnownPatch>,
    /// Charts of 24.
    #[serde(default)]
    pub charts: Vec<KnownChart>,
}

/// A chart in a photo.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct KnownChart {
    /// Which chart.
    pub chart: ChartKind,
    /// The pair's name.
    pub view: String,
    /// Outer corners of its corner patches in that photo, pixels: the first patch's (the greys being the lowest row, white
    /// left: the upper left one), then along the first row and round.
    pub corners_px: [[f64; 2]; 4],
}

/// One patch.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct KnownPatch {
    /// Its name.
    pub name: String,
    /// What it reflects.
    pub known: KnownColour,
    /// Where it is.
    pub place: Place,
}

/// What a patch reflects.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum KnownColour {
    /// Diffuse reflectance of a grey, 0 to 1: the same in all channels.
    Grey(f64),
    /// Diffuse reflectance in camera RGB, a perfect white being 1 1 1.
    CameraRgb([f64; 3]),
    /// Linear sRGB, D65.
    LinearSrgb([f64; 3]),
    /// CIELAB under D50.
    LabD50(Lab),
}

/// Where a patch is. Give the inner part of it, for lenses blur its edge.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case", deny_unknown_fields)]
pub enum Place {
    /// The surface about a point.
    Point {
        /// The point, world frame, metres.
        at_m: [f64; 3],
        /// How far the patch reaches, metres.
        radius_m: f64,
    },
    /// The surface within a flat quadrangle.
    Quad {
        /// Its corners in order round it, world frame, metres.
        corners_m: [[f64; 3]; 4],
    },
    /// A rectangle of the texture.
    Texture {
        /// One corner, (u, v), v upwards.
        from_uv: [f64; 2],
        /// The other.
        to_uv: [f64; 2],
    },
    /// What one photo shows within a polygon.
    View {
        /// The pair's name.
        name: String,
        /// Corners in order, pixels from the photo's top left corner.
        polygon_px: Vec<[f64; 2]>,
    },
}

impl PatchList {
    /// Reads the list, charts patch by patch; refuses what cannot be.
    pub(super) fn parse(bytes: &[u8], views: &[&str]) -> Result<Vec<KnownPatch>, CertifyError> {
        let Self { mut patches, charts } =
            serde_json::from_slice(bytes).map_err(|e| CertifyError::Patches(e.to_string()))?;
        for chart in charts {
            patches.extend(chart.patches()?);
        }
        if patches.is_empty() {
            return Err(CertifyError::Patches("it names no patch".into()));
        }
        let mut names = BTreeSet::new();
        for patch in &patches {
            let wrong = |what: String| CertifyError::Patch { name: patch.name.clone(), what };
            if !names.insert(patch.name.as_str()) {
                return Err(wrong("is named twice; give each its own name".into()));
            }
            patch.known.check().and_then(|()| patch.place.check(views)).map_err(wrong)?;
        }
        Ok(patches)
    }
}

impl KnownChart {
    /// Its patches, the middle of each.
    fn patches(&self) -> Result<Vec<KnownPatch>, CertifyError> {
        let Self { chart, view, corners_px } = self;
        let image_from_chart = image_from_corners(corners_px.map(DVec2::from_array)).ok_or_else(|| {
            let what = format!("has corners in view {view} that are no quadrangle: give them in order");
            CertifyError::Patch { name: chart.name().into(), what }
        })?;
        let patch = |(k, (name, lab)): (usize, &(&str, Lab))| {
            let polygon_px = measured_corners(&image_from_chart, k).map(|p| p.to_array()).to_vec();
            KnownPatch {
                name: format!("{name}, chart in view {view}"),
                known: KnownColour::LabD50(*lab),
                place: Place::View { name: view.clone(), polygon_px },
            }
        };
        Ok(chart.patches().iter().enumerate().map(patch).collect())
    }
}

impl KnownColour {
    fn check(&self) -> Result<(), String> {
        let between = |values: &[f64], low: f64, high: f64, what: &str| {
            let fine = values.iter().all(|v| v.is_finite() && *v > low && *v <= high);
            fine.then_some(()).ok_or_else(|| format!("is known as {values:?}, but {what}"))
        };
        match self {
            Self::Grey(r) => between(&[*r], 0.0, 1.0, "a reflectance is above 0 and at most 1"),
            Self::CameraRgb(rgb) => between(rgb, 0.0, 1.0, "a reflectance is above 0 and at most 1"),
            Self::LinearSrgb(rgb) => {
                between(rgb, -1.0, 1.5, "linear sRGB of a surface is about 0 to 1, not 0 to 255")
            }
            Self::LabD50([l, a, b]) => between(&[*l], 0.0, 100.0, "L* is above 0 and at most 100")
                .and_then(|()| between(&[*a, *b], -160.0, 160.0, "a* and b* of a surface lie within 160")),
        }
    }

    /// Whether it is a colour, which only a camera whose colours are known can be compared with.
    pub(super) fn needs_matrix(&self) -> bool {
        matches!(self, Self::LinearSrgb(_) | Self::LabD50(_))
    }

    /// In camera RGB. An error says why it cannot be told.
    pub(super) fn in_camera_rgb(&self, matrix: Option<&SessionMatrix>) -> Result<[f64; 3], String> {
        let xyz_d50 = match *self {
            Self::Grey(r) => return Ok([r; 3]),
            Self::CameraRgb(rgb) => return Ok(rgb),
            Self::LinearSrgb(rgb) => {
                let adapted = adapt(LINEAR_SRGB.white_xyz(), PCS_WHITE) * LINEAR_SRGB.xyz_from_rgb();
                adapted * DVec3::from_array(rgb)
            }
            Self::LabD50(lab) => xyz(lab),
        };
        let matrix = matrix.ok_or(
            "its colour is known, but nobody knows this camera's colours: shoot a chart (`unlit calibrate colour`), or \
             give it as `grey` or `camera_rgb`",
        )?;
        let rgb = matrix.xyz_from_camera().inverse() * xyz_d50;
        if !(rgb.is_finite() && rgb.cmpgt(DVec3::ZERO).all()) {
            let [r, g, b] = rgb.to_array();
            return Err(format!(
                "it is a colour that the camera's matrix makes {r:.4} {g:.4} {b:.4} in the camera's RGB, of which no share can be taken"
            ));
        }
        Ok(rgb.to_array())
    }
}

impl Place {
    fn check(&self, views: &[&str]) -> Result<(), String> {
        let finite = |values: &[f64]| {
            values
                .iter()
                .all(|v| v.is_finite())
                .then_some(())
                .ok_or_else(|| "has a place that is no number".to_owned())
        };
        match self {
            Self::Point { at_m, radius_m } => {
                finite(at_m)?;
                let fine = radius_m.is_finite() && *radius_m > 0.0;
                fine.then_some(()).ok_or_else(|| format!("has a radius of {radius_m} m; it must be above 0"))
            }
            Self::Quad { corners_m } => {
                corners_m.iter().try_for_each(|corner| finite(corner))?;
                let corners = corners_m.map(DVec3::from_array);
                let normal = (corners[2] - corners[0]).cross(corners[3] - corners[1]);
                let turns = (0..4).all(|k| {
                    let (a, b, c) = (corners[k], corners[(k + 1) % 4], corners[(k + 2) % 4]);
                    (b - a).cross(c - b).dot(normal) > 0.0
                });
                turns
                    .then_some(())
                    .ok_or_else(|| "has corners that do not go round a quadrangle: give them in order".into())
            }
            Self::Texture { from_uv, to_uv } => {
                finite(from_uv)?;
                finite(to_uv)?;
                let inside = from_uv.iter().chain(to_uv).all(|v| (0.0..=1.0).contains(v));
                inside.then_some(()).ok_or_else(|| {
                    format!("has texture coordinates {from_uv:?} to {to_uv:?}; they go from 0 to 1")
                })
            }
            Self::View { name, polygon_px } => {
                polygon_px.iter().try_for_each(|p| finite(p))?;
                if !views.contains(&name.as_str()) {
                    return Err(format!(
                        "is to be seen in view {name:?}, which is not in the model; it has {}",
                        views.join(", ")
                    ));
                }
                let fine = polygon_px.len() >= 3;
                fine.then_some(()).ok_or_else(|| "has a polygon of less than three corners".into())
            }
        }
    }
}

/// Whether a point lies in a polygon (crossing number).
pub(super) fn within(polygon: &[DVec2], p: DVec2) -> bool {
    let mut inside = false;
    for (k, a) in polygon.iter().enumerate() {
        let b = polygon[(k + 1) % polygon.len()];
        if (a.y > p.y) != (b.y > p.y) && p.x < a.x + (p.y - a.y) / (b.y - a.y) * (b.x - a.x) {
            inside = !inside;
        }
    }
    inside
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::codec::raw::colour::{CameraColour, ColourSource};
    use crate::pipeline::colour::Basis;

    fn refused(patch: &str) -> String {
        let text = format!("{{\"patches\": [{patch}]}}");
        PatchList::parse(text.as_bytes(), &["0001"]).unwrap_err().to_string()
    }

    #[test]
    fn a_list_is_read_and_what_cannot_be_is_refused_by_name() {
        let grey =
            |place: &str| format!("{{\"name\": \"g\", \"known\": {{\"grey\": 0.18}}, \"place\": {place}}}");
        let point = grey("{\"point\": {\"at_m\": [0, 0, 1], \"radius_m\": 0.01}}");
        let text = format!("{{\"patches\": [{point}]}}");
        assert_eq!(PatchList::parse(text.as_bytes(), &[]).unwrap()[0].known, KnownColour::Grey(0.18));
        for (patch, words) in [
            (format!("{point}, {point}"), "named twice"),
            (String::new(), "names no patch"),
            (point.replace("0.18", "18"), "at most 1"),
            (point.replace("grey", "gray"), "unknown variant `gray`"),
            (point.replace("0.01", "0"), "above 0"),
            (point.replace("radius_m", "radius"), "radius_m"),
            (grey("{\"view\": {\"name\": \"7\", \"polygon_px\": [[0, 0], [9, 0], [9, 9]]}}"), "it has 0001"),
            (grey("{\"view\": {\"name\": \"0001\", \"polygon_px\": [[0, 0]]}}"), "less than three"),
            (grey("{\"texture\": {\"from_uv\": [0, 0], \"to_uv\": [2, 1]}}"), "from 0 to 1"),
            (grey("{\"quad\": {\"corners_m\": [[0,0,0],[1,1,0],[1,0,0],[0,1,0]]}}"), "in order"),
        ] {
            let told = refused(&patch);
            assert!(told.contains(words), "{told}");
        }
        let chart =
            "{\"charts\": [{\"chart\": \"colorchecker24\", \"view\": \"0001\", \"corners_px\": CORNERS}]}";
        let turned = chart.replace("CORNERS", "[[100, 100], [700, 100], [700, 500], [100, 500]]");
        let all = PatchList::parse(turned.as_bytes(), &["0001"]).unwrap();
        assert!(all.len() == 24 && all[0].name.starts_with("dark skin"), "{:?}", all[0]);
        let Place::View { polygon_px, .. } = &all[23].place else { panic!("{:?}", all[23]) };
        assert!(polygon_px.iter().all(|p| (p[0] - 650.0).abs() < 40.0 && (p[1] - 450.0).abs() < 40.0));
        let line = chart.replace("CORNERS", "[[1, 1], [2, 2], [3, 3], [4, 4]]");
        assert!(PatchList::parse(line.as_bytes(), &["0001"]).is_err());
        let quad = grey("{\"quad\": {\"corners_m\": [[0,0,0],[1,0,0],[1,1,0],[0,1,0]]}}");
        let text = format!("{{\"patches\": [{quad}]}}");
        assert!(PatchList::parse(text.as_bytes(), &[]).is_ok());
    }

    #[test]
    fn a_white_is_white_however_it_is_given_and_colours_need_a_matrix() {
        let camera = CameraColour {
            camera_from_xyz: [
                [0.7034, -0.0804, -0.1014],
                [-0.4420, 1.2564, 0.2058],
                [-0.0851, 0.1994, 0.5758],
            ],
            white: [0.3127, 0.3290],
            source: ColourSource::FileTag,
        };
        let (white, xyz_from_camera) = crate::export::colour::of_maker(&camera);
        let matrix = SessionMatrix {
            xyz_d50_from_camera: crate::calibration::colour::rows(&xyz_from_camera),
            white: white.to_array(),
            basis: Basis::Maker { camera },
        };
        for known in [KnownColour::LinearSrgb([1.0; 3]), KnownColour::LabD50([100.0, 0.0, 0.0])] {
            let rgb = known.in_camera_rgb(Some(&matrix)).unwrap();
            assert!(rgb.iter().all(|v| (v - 1.0).abs() < 2e-3), "{rgb:?}");
            assert!(known.in_camera_rgb(None).unwrap_err().contains("calibrate colour"));
        }
        assert_eq!(KnownColour::Grey(0.2).in_camera_rgb(None).unwrap(), [0.2; 3]);
        let grey = KnownColour::LabD50([49.496, 0.0, 0.0]).in_camera_rgb(Some(&matrix)).unwrap();
        assert!(grey.iter().all(|v| (v - 0.18).abs() < 1e-3), "{grey:?}");
    }

    #[test]
    fn a_polygon_holds_what_lies_in_it() {
        let corner = [[0.0, 0.0], [4.0, 0.0], [4.0, 4.0], [2.0, 1.0], [0.0, 4.0]].map(DVec2::from);
        assert!(within(&corner, DVec2::new(0.5, 2.0)) && within(&corner, DVec2::new(3.5, 2.0)));
        assert!(!within(&corner, DVec2::new(2.0, 2.0)) && !within(&corner, DVec2::new(5.0, 1.0)));
    }
}
