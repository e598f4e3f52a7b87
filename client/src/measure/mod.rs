//! What is measured: how like two images are, how samples are spread, and when a frame passed which stage.
//!
//! Image error compares a displayed image with the server's converged rendering of the same display pose,
//! both as 8-bit sRGB, since that is what an eye gets. Nothing here reads a clock: instants are arguments.

mod error;
mod flip;
mod image_error;
mod percentiles;
mod psnr;
mod relative;
mod ssim;
mod stage;

pub use error::MeasureError;
pub use flip::{ErrorMap, PIXELS_PER_DEGREE, flip};
pub use image_error::{Compared, ImageError, compare};
pub use percentiles::Percentiles;
pub use psnr::{PSNR_CAP_DB, psnr_linear, psnr_srgb8};
pub use relative::relative_mse;
pub use ssim::dssim;
pub use stage::{FrameTimes, Interval, Side, Stage};
