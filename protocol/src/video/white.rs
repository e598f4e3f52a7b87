//! The radiance of a picture's largest code, kept for as long as it will do.
//!
//! A strip may have a white of its own; a picture that is predicted from the one before it must share its white, or every
//! code of it changes. So white is a power of two times the display's, grows as soon as something needs it, and shrinks
//! only when nothing has needed it for [`HOLD`] pictures.

use crate::codec::{FrameShape, PlaneKind, radiance_white};
use crate::frame::TreeRows;

/// Pictures for which a white outlasts what needed it: three seconds at ten a second. Each change costs about a key
/// picture.
const HOLD: u32 = 30;
/// Powers of two times the display's white that a source's may be: from dim fog to a segment in the sun.
const SOURCE_EXPONENTS: [i32; 2] = [-6, 3];

/// The white of one plane, from picture to picture.
#[derive(Clone, Copy, Debug, Default)]
pub struct White {
    exponent: Option<i32>,
    unneeded: u32,
}

impl White {
    /// The white of the next picture of this plane: `rows` are all rows of a tree of the shape.
    pub fn next(&mut self, shape: &FrameShape, rows: &TreeRows<'_>, node: u8, kind: PlaneKind) -> f32 {
        let display_white = 1.0 / shape.exposure;
        let (needed, exponents) = match kind {
            PlaneKind::Source => (brightest_source(rows, usize::from(node)), SOURCE_EXPONENTS),
            // Between the display's and four times that.
            _ => (radiance_white(shape, rows, usize::from(node)), [0, 2]),
        };
        let [least, most] = exponents;
        let covers = |exponent: i32| display_white * (exponent as f32).exp2() >= needed;
        let needed = (least..most).find(|&exponent| covers(exponent)).unwrap_or(most);
        display_white * (self.hold(needed) as f32).exp2()
    }

    fn hold(&mut self, needed: i32) -> i32 {
        let held = self.exponent.unwrap_or(needed);
        self.unneeded = if needed < held { self.unneeded + 1 } else { 0 };
        let exponent = if needed > held || self.unneeded > HOLD { needed } else { held };
        self.exponent = Some(exponent);
        exponent
    }
}

fn brightest_source(rows: &TreeRows<'_>, layer: usize) -> f32 {
    let planes = &rows.layers[layer];
    let mut brightest = 0.0_f32;
    for channel in &planes.source {
        for (&value, &optical_depth) in channel.iter().zip(planes.optical_depth.iter()) {
            // `max` drops NaN.
            brightest = if optical_depth > 0.0 { brightest.max(value) } else { brightest };
        }
    }
    brightest
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn white_grows_at_once_and_shrinks_late() {
        let mut white = White::default();
        assert_eq!(white.hold(0), 0);
        assert_eq!(white.hold(2), 2);
        let held: Vec<i32> = (0..=HOLD).map(|_| white.hold(1)).collect();
        assert!(held[..HOLD as usize].iter().all(|&exponent| exponent == 2), "{held:?}");
        assert_eq!(held[HOLD as usize], 1);
        // Once in a while is enough to keep it.
        white.hold(2);
        for picture in 0..200 {
            assert_eq!(white.hold(if picture % 20 == 0 { 2 } else { 0 }), 2);
        }
    }
}
