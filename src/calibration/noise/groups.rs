//! Frames of one light level among frames in any order.

/// Relative difference of means within a level: lamps flicker less, steps of a sixth of a stop are larger.
const RELATIVE: f64 = 0.03;
/// The same for dim levels, DN.
const ABSOLUTE: f64 = 0.5;

/// What a frame is sorted by.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FrameMean {
    /// Width and height.
    pub size: (usize, usize),
    /// Exposure time label, seconds.
    pub shutter: Option<f64>,
    /// f-number label.
    pub aperture: Option<f64>,
    /// Mean of all sites, DN above black.
    pub mean: f64,
}

/// Numbers of the frames of each light level, levels of equal settings together, dimmest first.
pub fn levels(frames: &[FrameMean]) -> Vec<Vec<usize>> {
    let key = |i: usize| (frames[i].size, frames[i].shutter, frames[i].aperture);
    let number = |label: Option<f64>| label.unwrap_or(-1.0);
    let mut order: Vec<usize> = (0..frames.len()).collect();
    order.sort_by(|&a, &b| {
        let (a, b) = (&frames[a], &frames[b]);
        (a.size.cmp(&b.size))
            .then(number(a.aperture).total_cmp(&number(b.aperture)))
            .then(number(a.shutter).total_cmp(&number(b.shutter)))
            .then(a.mean.total_cmp(&b.mean))
    });
    let mut groups: Vec<Vec<usize>> = vec![];
    for i in order {
        let fits = |group: &&mut Vec<usize>| {
            let first = frames[group[0]].mean;
            key(group[0]) == key(i) && frames[i].mean - first <= ABSOLUTE.max(RELATIVE * first)
        };
        match groups.last_mut().filter(fits) {
            Some(group) => group.push(i),
            None => groups.push(vec![i]),
        }
    }
    groups
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn frames_in_any_order_find_their_partners() {
        let frame = |mean: f64, shutter: f64| FrameMean {
            size: (120, 80),
            shutter: Some(shutter),
            aperture: None,
            mean,
        };
        let frames = [
            frame(800.0, 0.1),
            frame(14.1, 0.1),
            frame(9.0, 0.1),
            frame(14.2, 0.1),
            frame(805.0, 0.1),
            frame(802.0, 0.2),
            frame(8.8, 0.1),
        ];
        assert_eq!(levels(&frames), [vec![6, 2], vec![1, 3], vec![0, 4], vec![5]]);
        assert!(levels(&[]).is_empty());
    }
}
