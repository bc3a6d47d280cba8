//! Random numbers for tests.

/// Knuth's 64-bit linear congruential generator (MMIX).
pub struct Lcg(u64);

impl Lcg {
    pub fn new() -> Self {
        Self(20_170)
    }

    /// In [0, `below`).
    pub fn number(&mut self, below: f64) -> f64 {
        self.0 =
            self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        below * (self.0 >> 11) as f64 / (1_u64 << 53) as f64
    }

    /// In [−`bound`, `bound`).
    pub fn triple(&mut self, bound: f64) -> [f64; 3] {
        [(); 3].map(|()| self.number(2.0 * bound) - bound)
    }
}
