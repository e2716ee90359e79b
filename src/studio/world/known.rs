//! What is known of the world and a photographer would not know: for export beside photographs of it.

use super::{WorldError, cache, card, sensor, stage};
use crate::progress::Progress;
use crate::raster::blur::gaussian;
use crate::raster::{Image, Rgb};
use crate::scene::{Camera, Mesh};
use serde_json::{Value, json};

/// The world's own truth.
pub struct Known {
    /// The photographed object: the rendered surface is exactly these triangles.
    pub object: Mesh,
    /// The floor that it stands on.
    pub floor: Mesh,
    /// Reflectance of the object in its texture coordinates, row 0 at v = 1; 0 where no surface is.
    pub texture: Rgb,
    /// Cameras of all stops, named as pairs shot on one walk are numbered.
    pub cameras: Vec<Camera>,
    /// What each camera sees, in the same order.
    pub views: Vec<KnownView>,
    /// Sensor, lens, flash, exposure and poses, for `scene.json`.
    pub facts: Value,
}

/// Truth in one camera's pixels.
pub struct KnownView {
    /// Reflectance of whatever surface is met, through the lens blur; 0 beyond the floor.
    pub albedo: Rgb,
    /// Share of each pixel that is object, before the lens blur.
    pub coverage: Image<f32>,
}

/// Gathers the truth; traces light only when the program's stored renders do not fit it.
pub fn known(progress: &Progress) -> Result<Known, WorldError> {
    let surfaces = stage::surfaces();
    let cameras = stage::cameras();
    let views = cache::load(&surfaces, &cameras, progress)?
        .into_iter()
        .map(|render| KnownView {
            albedo: gaussian(&render.image.map(|s| s.albedo), sensor::LENS_SIGMA),
            coverage: render.image.map(|s| s.object),
        })
        .collect();
    let facts = facts(&cameras);
    let [object, floor] = surfaces;
    let paint = &object.reflectance;
    let texture = Rgb::from_fn(paint.size, paint.size, |x, y| {
        paint.texels[y * paint.size + x].map(|v| f32::from(v) / 65535.0)
    });
    Ok(Known { object: object.mesh, floor: floor.mesh, texture, cameras, views, facts })
}

fn facts(cameras: &[Camera]) -> Value {
    let frames: Vec<Value> = cameras
        .iter()
        .map(|camera| {
            let m = camera.world_from_camera;
            let row = |i: usize| {
                let columns = [m.matrix3.x_axis, m.matrix3.y_axis, m.matrix3.z_axis, m.translation];
                columns.map(|c| c[i])
            };
            json!({
                "name": camera.name,
                "world_from_camera": [row(0), row(1), row(2), [0.0, 0.0, 0.0, 1.0]],
            })
        })
        .collect();
    let (lens, ring) = (stage::INTRINSICS, stage::RING);
    let [a, b] = sensor::VIGNETTING;
    json!({
        "unit": "metre",
        "world": "right-handed, z up",
        "sensor": {
            "cfa": "RGGB",
            "black_dn": sensor::BLACK,
            "saturation_dn": sensor::SATURATION,
            "full_well_e": sensor::FULL_WELL,
            "read_noise_e": sensor::READ_NOISE,
            "electrons_per_dn": sensor::FULL_WELL / f64::from(sensor::SATURATION - sensor::BLACK),
            "vignetting": format!("V = 1 - {a} q - {b} q^2, q = (r/half diagonal)^2"),
            "lens_psf_sigma_px": f64::from(sensor::LENS_SIGMA * 1000.0).round() / 1000.0,
            "gain_rgb": sensor::GAIN,
            "radiance_at_full_well_green": sensor::FULL_RADIANCE,
        },
        "exposure": { "time_s": "1/125", "f_number": 11, "iso": 100 },
        "flash": {
            "shape": "annulus in the plane z=0 of the camera frame, centred on the pinhole, emitting towards +z \
                      (one-sided Lambertian), without a body of its own",
            "outer_radius": f64::from(ring.outer * 1e6).round() / 1e6,
            "inner_radius": f64::from(ring.inner * 1e6).round() / 1e6,
            "radiance_rgb": ring.radiance,
        },
        "card_reflectance": card::REFLECTANCE,
        "reflectance_space": "camera RGB (channels independent)",
        "truth": "truth/albedo/NAME.tif = reflectance*65535 as seen by the camera through its lens (blurred by \
                  lens_psf_sigma_px); truth/mask/NAME.tif = share of the pixel covered by the object*255; \
                  truth/texture.tif in the UVs of geometry/object.obj, row 0 at v=1, bilinear",
        "object": { "mesh": "geometry/object.obj", "specular_weight": 0.0 },
        "frames": frames,
        "intrinsics": {
            "width": lens.width,
            "height": lens.height,
            "fx": lens.focal.x,
            "fy": lens.focal.y,
            "cx": lens.principal.x,
            "cy": lens.principal.y,
            "focal_mm": stage::FOCAL_MM,
        },
    })
}
