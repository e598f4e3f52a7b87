//! The settings of each knob of volumes; all others stay at their defaults: four layers, ten degrees.

use super::super::Request;
use crate::march::{Method, STRIDE_PX};
use warplight_protocol::frame::{ColorCoding, ColorFormat, Layering, VolumeFormat};

/// The default way around.
const DEGREES: f64 = 10.0;

/// One setting: how a frame is layered and coded, and how it is shown from where.
#[derive(Clone, Debug)]
pub(in crate::sweep) struct Setting {
    pub(in crate::sweep) value: String,
    pub(in crate::sweep) format: VolumeFormat,
    /// How sources travel.
    pub(in crate::sweep) color: ColorCoding,
    /// By the plain program with many candidates, where the layering is optimal.
    pub(in crate::sweep) exactly: bool,
    pub(in crate::sweep) method: Method,
    pub(in crate::sweep) stride_px: f32,
    pub(in crate::sweep) degrees: f64,
    /// Factor on the extinction.
    pub(in crate::sweep) density: f32,
}

impl Setting {
    fn new(value: impl ToString) -> Setting {
        Setting {
            value: value.to_string(),
            format: VolumeFormat::default(),
            color: ColorCoding::Exact,
            exactly: false,
            method: Method::Layers,
            stride_px: STRIDE_PX,
            degrees: DEGREES,
            density: 1.0,
        }
    }

    /// Where no knob is turned.
    pub(super) fn of_default() -> Setting {
        Setting::new("default")
    }

    fn layered(layering: Layering, layers: u8) -> Setting {
        let format = VolumeFormat { layers, layering, ..VolumeFormat::default() };
        Setting { format, ..Setting::new(format!("{}:{layers}", layering.name())) }
    }
}

/// Every layering at every number of layers, and the plain program that the optimal one is measured against.
pub(in crate::sweep) fn layers(request: &Request<'_>) -> Vec<Setting> {
    let counts: &[u8] = if request.quick { &[4] } else { &[2, 4, 8] };
    let of_count = |&count: &u8| {
        let mut settings: Vec<Setting> = [Layering::Quantiles, Layering::Merged, Layering::Optimal]
            .map(|layering| Setting::layered(layering, count))
            .to_vec();
        let exact = Setting::layered(Layering::Optimal, count);
        settings.push(Setting { exactly: true, value: format!("exact:{count}"), ..exact });
        settings
    };
    counts.iter().flat_map(of_count).collect()
}

/// Every rule at every number of layers; the plain program, which takes its time, not in a quick sweep.
pub(in crate::sweep) fn rules(request: &Request<'_>) -> Vec<Setting> {
    let counts: &[u8] = if request.quick { &[4] } else { &[2, 4, 8] };
    let of_count = |&count: &u8| {
        let mut settings: Vec<Setting> = [Layering::Slabs, Layering::Quantiles, Layering::Merged, Layering::Optimal]
            .map(|layering| Setting::layered(layering, count))
            .to_vec();
        if !request.quick {
            let exact = Setting::layered(Layering::Optimal, count);
            settings.push(Setting { exactly: true, value: format!("exact:{count}"), ..exact });
        }
        settings
    };
    counts.iter().flat_map(of_count).collect()
}

/// Each method with its layers.
fn methods(request: &Request<'_>) -> Vec<Setting> {
    let counts: &[u8] = if request.quick { &[4] } else { &[2, 4, 8] };
    let layers = counts.iter().map(|&count| {
        let value = format!("layers:{count}");
        Setting { value, ..Setting::layered(Layering::Optimal, count) }
    });
    let slabs = Setting { method: Method::Slabs, value: "slabs:4".to_owned(), ..Setting::layered(Layering::Slabs, 4) };
    let mean =
        Setting { method: Method::MeanDepth, value: "mean-depth".to_owned(), ..Setting::layered(Layering::Optimal, 8) };
    layers.chain([slabs, mean]).collect()
}

/// Each method, further and further around.
pub(in crate::sweep) fn angles(request: &Request<'_>) -> Vec<Setting> {
    let angles: &[f64] = if request.quick { &[10.0] } else { &[5.0, 10.0, 15.0] };
    let at = |&degrees: &f64| {
        methods(request).into_iter().map(move |setting| Setting {
            value: format!("{} {degrees:.0} deg", setting.value),
            degrees,
            ..setting
        })
    };
    angles.iter().flat_map(at).collect()
}

/// Each method, from almost clear to a surface.
pub(in crate::sweep) fn densities(request: &Request<'_>) -> Vec<Setting> {
    let densities: &[f32] = if request.quick { &[0.1, 10.0] } else { &[0.01, 0.1, 0.3, 1.0, 3.0, 10.0, 100.0] };
    let at = |&density: &f32| {
        methods(request)
            .into_iter()
            .filter(|setting| setting.format.layers == 4 || setting.method != Method::Layers)
            .map(move |setting| Setting { value: format!("{} x{density}", setting.value), density, ..setting })
    };
    densities.iter().flat_map(at).collect()
}

/// The planes of layers in ever fewer bits, sources as they are, within bounds and as video, for two, four and eight layers.
pub(in crate::sweep) fn compressions(request: &Request<'_>) -> Vec<Setting> {
    let counts: &[u8] = if request.quick { &[4] } else { &[2, 4, 8] };
    let (exact, within, video) =
        (ColorCoding::Exact, |error| ColorCoding::Bounded { error }, |quantiser| ColorCoding::Video { quantiser });
    let codings: &[(ColorFormat, ColorCoding, u8, u8)] = &[
        (ColorFormat::Half, exact, 16, 16),
        (ColorFormat::Root10, exact, 14, 10),
        (ColorFormat::Root8, exact, 12, 10),
        (ColorFormat::Root8, exact, 12, 8),
        (ColorFormat::Linear8, exact, 12, 8),
        (ColorFormat::Root8, exact, 10, 8),
        (ColorFormat::Root8, exact, 8, 6),
        (ColorFormat::Root8, within(2), 10, 8),
        (ColorFormat::Root8, within(8), 10, 8),
        (ColorFormat::Root8, within(2), 8, 7),
        (ColorFormat::Root8, within(8), 8, 7),
        (ColorFormat::Root8, within(4), 7, 6),
        (ColorFormat::Root8, within(8), 6, 5),
        (ColorFormat::Root8, within(16), 5, 4),
        (ColorFormat::Root8, within(32), 4, 4),
        (ColorFormat::Root8, video(24), 10, 8),
        (ColorFormat::Root8, video(32), 7, 6),
        (ColorFormat::Root8, video(40), 5, 4),
    ];
    let of_count = |&layers: &u8| {
        let layerings: &[Layering] = if request.quick {
            &[Layering::Optimal]
        } else {
            &[Layering::Optimal, Layering::Merged, Layering::Quantiles]
        };
        layerings.iter().flat_map(move |&layering| {
            codings.iter().map(move |&(source, color, depth_bits, optical_depth_bits)| {
                let format = VolumeFormat { layers, layering, depth_bits, optical_depth_bits, source };
                let sources = if color == ColorCoding::Exact { format!("{source:?}") } else { color.to_string() };
                let value = format!("{}:{layers} {sources}/{depth_bits}/{optical_depth_bits}", layering.name());
                Setting { format, color, ..Setting::new(value) }
            })
        })
    };
    counts.iter().flat_map(of_count).collect()
}
