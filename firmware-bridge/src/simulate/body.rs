//! The mechanics of a simulated arm: one straight leg at a time, at constant speed, and two fingers.

use super::Motion;

/// Where the arm stands and where it is going.
#[derive(Clone, Debug)]
pub struct Body {
    at_mm: [f64; 3],
    leg: Option<Leg>,
    /// Speed, mm/s.
    pub speed_mm_s: f64,
}

#[derive(Clone, Copy, Debug)]
struct Leg {
    from_mm: [f64; 3],
    to_mm: [f64; 3],
    start_ns: i64,
    end_ns: i64,
}

impl Body {
    /// Standing still.
    pub fn new(at_mm: [f64; 3], speed_mm_s: f64) -> Self {
        Self { at_mm, leg: None, speed_mm_s }
    }

    /// Starts towards a point; a leg under way is given up.
    pub fn go(&mut self, to_mm: [f64; 3], now_ns: i64) -> Motion {
        let from_mm = self.position_mm(now_ns);
        let length_mm = (0..3).map(|i| (to_mm[i] - from_mm[i]).powi(2)).sum::<f64>().sqrt();
        let end_ns = now_ns + (length_mm / self.speed_mm_s * 1e9) as i64;
        self.leg = Some(Leg { from_mm, to_mm, start_ns: now_ns, end_ns });
        Motion::Began { to_mm }
    }

    /// Where it is.
    pub fn position_mm(&self, now_ns: i64) -> [f64; 3] {
        let Some(leg) = self.leg else { return self.at_mm };
        let part = if leg.end_ns > leg.start_ns {
            ((now_ns - leg.start_ns) as f64 / (leg.end_ns - leg.start_ns) as f64).clamp(0.0, 1.0)
        } else {
            1.0
        };
        core::array::from_fn(|i| leg.from_mm[i] + (leg.to_mm[i] - leg.from_mm[i]) * part)
    }

    /// When the leg under way ends.
    pub fn arrives_ns(&self) -> Option<i64> {
        self.leg.map(|leg| leg.end_ns)
    }

    /// Ends the leg if its time has come.
    pub fn arrive(&mut self, now_ns: i64) -> Option<Motion> {
        let leg = self.leg.filter(|leg| leg.end_ns <= now_ns)?;
        self.leg = None;
        self.at_mm = leg.to_mm;
        Some(Motion::Arrived { at_mm: leg.to_mm })
    }

    /// Stops at once.
    pub fn stop(&mut self, now_ns: i64) -> Option<Motion> {
        let at_mm = self.position_mm(now_ns);
        self.leg.take()?;
        self.at_mm = at_mm;
        Some(Motion::Stopped { at_mm })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_leg_takes_its_time_and_stops_where_it_is() {
        let mut body = Body::new([0.0; 3], 100.0);
        body.go([30.0, 40.0, 0.0], 0);
        assert_eq!(body.arrives_ns(), Some(500_000_000));
        assert_eq!(body.arrive(499_999_999), None);
        assert_eq!(body.stop(250_000_000), Some(Motion::Stopped { at_mm: [15.0, 20.0, 0.0] }));
        assert_eq!(body.stop(260_000_000), None);
        body.go([15.0, 20.0, 10.0], 1_000_000_000);
        assert_eq!(body.arrive(1_100_000_000), Some(Motion::Arrived { at_mm: [15.0, 20.0, 10.0] }));
    }
}
