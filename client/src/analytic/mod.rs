//! Scenes of planes and balls in closed form, and how far from the truth the specular flow is on them.
//!
//! The measuring stick of mode `specular`, beside the pipeline: `scenes` says what a ray meets, in f64; `frame`
//! makes a ray tree of it and sends it through the wire format; `truth` knows for a display pose what is seen
//! where, and compares a flow with it. The oracle tests of `warp` and the command `sweep` use them.
//!
//! **The error.** At a pixel the novel chain of rays ends at a point P, seen from the last boundary w. Where the flow
//! says to look in the old picture, the old chain ends at another point. The error is the angle between the two at w:
//! what a viewer would see displaced. Pixels that no place in the old picture shows are left out: those for which a
//! search in f64 finds no place within 0.02 degrees.
//!
//! Limits: reflection and refraction once, or through one solid; the surfaces behind are plain, so that the error of
//! the flow is not mixed with that of colour. Cost: a second or so a scene of 1024 x 1024 pixels.

mod frame;
mod scenes;
mod truth;

pub use frame::through_the_wire;
pub use scenes::{AnalyticScene, Bounce};
pub use truth::{FlowErrors, Truth};
