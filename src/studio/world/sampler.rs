//! Low-discrepancy sample points for the path tracer.
//!
//! Every two dimensions of a path are a (0,2)-sequence of Sobol' of their own, its order shuffled and its points
//! Owen-scrambled with seeds of their own, after Burley, "Practical Hash-based Owen Scrambling", JCGT 9(4), 2020.
//! Each scrambled point is uniform in the unit square, so estimates stay unbiased.

use glam::Vec2;

/// Mixes 32 bits so that each output bit depends on all input bits.
fn mix(mut x: u32) -> u32 {
    x = (x ^ (x >> 16)).wrapping_mul(0x7feb_352d);
    x = (x ^ (x >> 15)).wrapping_mul(0x846c_a68b);
    x ^ (x >> 16)
}

/// A hash of a running hash and one more number.
pub(super) fn combine(seed: u32, value: u32) -> u32 {
    mix(seed ^ value.wrapping_add(0x9e37_79b9).wrapping_add(seed << 6).wrapping_add(seed >> 2))
}

/// Owen's nested scramble of the binary digits after the point of `x / 2^32`.
fn scramble(x: u32, seed: u32) -> u32 {
    let mut x = x.reverse_bits().wrapping_add(seed);
    x ^= x.wrapping_mul(0x6c50_b47c);
    x ^= x.wrapping_mul(0xb82f_1e52);
    x ^= x.wrapping_mul(0xc7af_e638);
    x ^= x.wrapping_mul(0x8d22_f6e6);
    x.reverse_bits()
}

/// Point `index` of the two-dimensional Sobol' sequence, as binary fractions of 2^32.
fn sobol(index: u32) -> [u32; 2] {
    // The second dimension's matrix is Pascal's triangle modulo 2, which factors into five exchanges of bits.
    let mut x = index;
    for (shift, mask) in
        [(1, 0xaaaa_aaaa_u32), (2, 0xcccc_cccc), (4, 0xf0f0_f0f0), (8, 0xff00_ff00), (16, 0xffff_0000)]
    {
        x ^= (x & mask) >> shift;
    }
    [index.reverse_bits(), x.reverse_bits()]
}

/// A binary fraction of 2^32 as a number in [0, 1).
fn unit(x: u32) -> f32 {
    (x >> 8) as f32 * (1.0 / 16_777_216.0)
}

/// Gives the coordinates of one path, two at a time.
pub(super) struct Sampler {
    seed: u32,
    index: u32,
    dimension: u32,
}

impl Sampler {
    /// Sample `index` of the set that `seed` names (one seed a pixel and pass).
    pub(super) fn new(seed: u32, index: u32) -> Self {
        Self { seed, index, dimension: 0 }
    }

    /// The next two coordinates, each in [0, 1).
    pub(super) fn next(&mut self) -> Vec2 {
        let seed = combine(self.seed, self.dimension);
        self.dimension += 1;
        let [x, y] = sobol(scramble(self.index, seed));
        Vec2::new(unit(scramble(x, combine(seed, 1))), unit(scramble(y, combine(seed, 2))))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sixty_four_points_fill_every_elementary_interval_once() {
        for dimension in 0..5 {
            for (columns, rows) in [(64, 1), (16, 4), (8, 8), (2, 32)] {
                let mut count = vec![0; 64];
                for index in 0..64 {
                    let mut sampler = Sampler::new(77, index);
                    sampler.dimension = dimension;
                    let p = sampler.next();
                    count[(p.y * rows as f32) as usize * columns + (p.x * columns as f32) as usize] += 1;
                }
                assert!(count.iter().all(|&n| n == 1), "{columns}x{rows} in dimension pair {dimension}");
            }
        }
    }

    #[test]
    fn dimension_pairs_are_not_correlated() {
        let n = 4096;
        let sum: f32 = (0..n)
            .map(|i| {
                let mut sampler = Sampler::new(5, i);
                (sampler.next().x - 0.5) * (sampler.next().x - 0.5) * 12.0
            })
            .sum();
        assert!((sum / n as f32).abs() < 0.05, "{}", sum / n as f32);
    }
}
