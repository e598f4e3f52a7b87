//! Whatever tree is encoded, it decodes, and to the values its format promises.

#![no_main]

use arbitrary::{Result, Unstructured};
use libfuzzer_sys::fuzz_target;
use warplight_protocol::curvature::ShapeOperator;
use warplight_protocol::frame::{Arrival, ColorCoding, DepthCoding, DepthFormat, FrameFormat, UNDEFINED};
use warplight_protocol_fuzz::{LIMITS, decode, encode, shape, tree};

fuzz_target!(|bytes: &[u8]| {
    let _ = run(Unstructured::new(bytes));
});

fn run(mut u: Unstructured<'_>) -> Result<()> {
    let shape = shape(&mut u)?;
    shape.check(&LIMITS).expect("a possible shape");
    let mut tree = tree(&shape, &mut u)?;
    let strips = encode(&shape, &mut tree);
    let back = decode(&shape, strips.iter().map(Vec::as_slice)).expect("own bytes");
    let white = 1.0 / shape.exposure;
    for (node, (was, is)) in tree.nodes.iter().zip(&back.nodes).enumerate() {
        for pixel in 0..was.distance.len() {
            let defined = node == 0 || was.distance[pixel] != UNDEFINED;
            assert_eq!(defined, is.distance[pixel] != UNDEFINED);
            if !defined {
                continue;
            }
            assert!(was.distance[pixel] != f32::INFINITY || is.distance[pixel] == f32::INFINITY);
            // The white of a reflection depends on the strip; all others are the display's.
            let error = match shape.format.color_coding {
                ColorCoding::Exact => Some(0),
                ColorCoding::Bounded { error } => Some(u16::from(error)),
                ColorCoding::Video { .. } => None,
            };
            if let Some(error) = error.filter(|_| shape.plan.nodes()[node].arrival != Arrival::Reflected) {
                for channel in 0..3 {
                    let color = shape.format.color;
                    let code = color.quantise(was.radiance[channel][pixel], white);
                    let decoded = is.radiance[channel][pixel];
                    match error {
                        0 => assert_eq!(decoded, color.dequantise(code, white)),
                        error => assert!(color.quantise(decoded, white).abs_diff(code) <= error),
                    }
                }
            }
            if let Some(&interface) = was.interface.get(pixel) {
                let known = usize::from(interface) <= shape.interfaces.0.len();
                assert_eq!(is.interface[pixel], if known { interface } else { 0 });
                // A flat surface comes back flat, whatever there is beside it.
                if known && interface > 0 && was.shape_at(pixel) == Some(ShapeOperator::FLAT) {
                    assert_eq!(is.shape_at(pixel), Some(ShapeOperator::FLAT));
                }
            }
        }
    }

    // Distances that are only their own codes are at rest after the first coding.
    let relative = FrameFormat { child_depth: DepthCoding::Relative, ..shape.format };
    if shape.format == relative && matches!(shape.format.depth, DepthFormat::Codes { .. }) {
        let again = encode(&shape, &mut back.clone());
        let again = decode(&shape, again.iter().map(Vec::as_slice)).expect("own bytes");
        for (once, twice) in back.nodes.iter().zip(&again.nodes) {
            assert_eq!(once.interface, twice.interface);
            for (once, twice) in once.distance.iter().zip(&twice.distance) {
                assert_eq!(*once == UNDEFINED, *twice == UNDEFINED);
                assert_eq!(once.is_infinite(), twice.is_infinite());
            }
        }
    }
    Ok(())
}
