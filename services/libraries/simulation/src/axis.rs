//! One axis of a walk through the squares of a grid: beams through pixels and through the index of segments use it.

/// A beam's way from square to square along one axis of a grid (Amanatides and Woo 1987).
pub(super) struct Axis {
    /// The square that the beam is in, in this axis.
    pub(super) cell: i64,
    step: i64,
    /// Distance along the beam to the next border of this axis, metres.
    pub(super) next_m: f64,
    /// From border to border, metres.
    every_m: f64,
}

impl Axis {
    /// `position` in squares, `rate` in squares per metre of the beam.
    pub(super) fn new(position: f64, rate: f64) -> Self {
        let cell = position.floor();
        let border = if rate > 0.0 { cell + 1.0 } else { cell };
        let next_m = if rate == 0.0 { f64::INFINITY } else { (border - position) / rate };
        Self { cell: cell as i64, step: if rate > 0.0 { 1 } else { -1 }, next_m, every_m: 1.0 / rate.abs() }
    }

    /// Crosses the next border; returns its distance along the beam, metres.
    pub(super) fn advance(&mut self) -> f64 {
        let crossed_m = self.next_m;
        self.cell += self.step;
        self.next_m += self.every_m;
        crossed_m
    }

    /// Whether the walk is outside of `count` squares and goes on outward.
    pub(super) fn leaves(&self, count: usize) -> bool {
        if self.step > 0 { self.cell >= count as i64 } else { self.cell < 0 }
    }
}
