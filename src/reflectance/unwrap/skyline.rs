//! Rectangles in a square, by the skyline: each goes where its top ends lowest (bottom-left rule, after Jylänki,
//! "A thousand ways to pack the bin", 2010).

/// A stretch of the skyline: from column `x`, `width` columns, filled up to row `top`.
#[derive(Clone, Copy)]
struct Step {
    x: u32,
    width: u32,
    top: u32,
}

/// Places rectangles (width, height) in a square of `side`; gives their lower left corners, or `None` if they do not
/// fit. They are placed in the order given: highest first packs best.
pub(super) fn pack(side: u32, rectangles: impl IntoIterator<Item = (u32, u32)>) -> Option<Vec<(u32, u32)>> {
    let mut line = vec![Step { x: 0, width: side, top: 0 }];
    rectangles.into_iter().map(|(width, height)| place(&mut line, side, width, height)).collect()
}

fn place(line: &mut Vec<Step>, side: u32, width: u32, height: u32) -> Option<(u32, u32)> {
    let (mut best, mut lowest) = (None, u32::MAX);
    for i in 0..line.len() {
        if side - line[i].x < width {
            break;
        }
        if let Some(top) = resting(line, i, width, lowest) {
            (best, lowest) = (Some(i), top);
        }
    }
    let first = best?;
    let top = lowest.checked_add(height).filter(|&top| top <= side)?;
    let x = line[first].x;
    let end = x + width;
    let last = first + line[first..].iter().take_while(|s| s.x + s.width <= end).count();
    if let Some(cut) = line.get_mut(last)
        && cut.x < end
    {
        cut.width -= end - cut.x;
        cut.x = end;
    }
    line.splice(first..last, [Step { x, width, top }]);
    Some((x, lowest))
}

/// Row on which a rectangle rests that begins at step `i`; `None` unless it is below `lowest`.
fn resting(line: &[Step], i: usize, width: u32, lowest: u32) -> Option<u32> {
    let end = line[i].x + width;
    let mut row = 0;
    for step in line[i..].iter().take_while(|s| s.x < end) {
        row = row.max(step.top);
        if row >= lowest {
            return None;
        }
    }
    Some(row)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn four_quarters_fill_a_square_and_a_fifth_does_not_fit() {
        assert!(pack(8, [(4, 4); 4]).is_some());
        assert!(pack(8, [(4, 4); 5]).is_none());
        assert!(pack(8, [(9, 1)]).is_none());
        assert!(pack(8, [(1, 9)]).is_none());
    }

    proptest! {
        #[test]
        fn rectangles_lie_inside_and_apart(mut sizes in prop::collection::vec((1u32..20, 1u32..20), 1..40)) {
            sizes.sort_by_key(|&(w, h)| std::cmp::Reverse((h, w)));
            let places = pack(128, sizes.iter().copied()).unwrap();
            let mut taken = vec![false; 128 * 128];
            for ((x, y), (w, h)) in places.into_iter().zip(sizes) {
                prop_assert!(x + w <= 128 && y + h <= 128);
                for row in y..y + h {
                    for column in x..x + w {
                        let cell = &mut taken[(row * 128 + column) as usize];
                        prop_assert!(!*cell);
                        *cell = true;
                    }
                }
            }
        }
    }
}
