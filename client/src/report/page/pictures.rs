//! The pictures: reference and modes side by side, each mode above the map of its error.

use super::PictureSet;
use super::html::{escaped, figure};
use crate::measure::{ImageError, PSNR_CAP_DB};
use base64::Engine;
use base64::engine::general_purpose::STANDARD;
use image::codecs::png::{CompressionType, FilterType, PngEncoder};
use image::{ExtendedColorType, ImageEncoder, RgbImage};
use std::io;

/// All sets, with the scale of the error maps; nothing without sets.
pub(super) fn section(sets: &[PictureSet]) -> io::Result<String> {
    if sets.is_empty() {
        return Ok(String::new());
    }
    let sets: Vec<String> = sets.iter().map(set).collect::<io::Result<_>>()?;
    Ok(format!(
        "<section>\n<h2>What was displayed</h2>\n\
         <p class=\"hint\">Below each mode: where it differs from the reference (FLIP), \
         <span class=\"scale\">none <i class=\"magma\"></i> strong</span>\
         <span class=\"script-only\">. Click a picture to see the reference in its place.</span></p>\n{}</section>\n",
        sets.concat()
    ))
}

fn set(set: &PictureSet) -> io::Result<String> {
    let title = escaped(&set.title);
    let time_s = set.time_s;
    let reference = image(&set.reference, "reference", &format!("{title}, reference at {time_s:.2} s"))?;
    let mut figures = format!(
        "<figure class=\"shot\"><div class=\"pair\">{reference}</div>\n<figcaption><b>reference</b>\
         <span>converged, display pose at {time_s:.2} s</span></figcaption></figure>\n"
    );
    for (mode, shown, map, error) in &set.modes {
        let mode = escaped(mode);
        let ImageError { psnr_db, dssim, flip } = *error;
        let picture = image(shown, "mode", &format!("{title}, mode {mode} at {time_s:.2} s"))?;
        let map = image(map, "map", &format!("error map of mode {mode}, mean FLIP {}", figure(flip)))?;
        let psnr = if psnr_db >= PSNR_CAP_DB { "identical".into() } else { format!("PSNR {} dB", figure(psnr_db)) };
        let (dssim, flip) = (figure(dssim), figure(flip));
        figures.push_str(&format!(
            "<figure class=\"shot\"><div class=\"pair\">{picture}{map}</div>\n<figcaption><b>{mode}</b>\
             <span>{psnr}</span> <span>DSSIM {dssim}</span> <span>FLIP {flip}</span></figcaption></figure>\n"
        ));
    }
    Ok(format!(
        "<article class=\"set\">\n<h3>{title} <small>at {time_s:.2} s</small></h3>\n<div class=\"shots\">\n{figures}</div>\n</article>\n"
    ))
}

/// An `img` that holds its own bytes; `alt` is escaped already.
fn image(pixels: &RgbImage, class: &str, alt: &str) -> io::Result<String> {
    let (width, height) = pixels.dimensions();
    let mut png = Vec::new();
    PngEncoder::new_with_quality(&mut png, CompressionType::Best, FilterType::Adaptive)
        .write_image(pixels.as_raw(), width, height, ExtendedColorType::Rgb8)
        .map_err(io::Error::other)?;
    let data = STANDARD.encode(png);
    Ok(format!(
        "<img class=\"{class}\" width=\"{width}\" height=\"{height}\" alt=\"{alt}\" src=\"data:image/png;base64,{data}\">"
    ))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_picture_survives_the_page() {
        let picture = RgbImage::from_fn(7, 5, |x, y| image::Rgb([x as u8 * 30, y as u8 * 50, 7]));
        let html = super::image(&picture, "mode", "alt").unwrap();
        let data = html.split("base64,").nth(1).unwrap().trim_end_matches("\">");
        let png = STANDARD.decode(data).unwrap();
        assert_eq!(::image::load_from_memory(&png).unwrap().to_rgb8(), picture);
    }

    #[test]
    fn no_pictures_no_section() {
        assert_eq!(section(&[]).unwrap(), "");
    }
}
