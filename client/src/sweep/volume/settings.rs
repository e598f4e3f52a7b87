//! The settings of each knob of volumes; all others stay at their defaults: four layers, ten degrees.

use super::super::Request;
use crate::march::{Method, STRIDE_PX};
use warplight_protocol::frame::{ColorFormat, Layering, VolumeFormat};

/// The default way around.
const DEGREES: f64 = 10.0;

/// One setting: how a frame is layered and coded, and how it is shown from where.
#[derive(Clone, Debug)]
pub(in crate::sweep) struct Setting {
    pub(in crate::sweep) value: String,
    pub(in crate::sweep) format: VolumeFormat,
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
            exactly: false,
            method: Method::Layers,
            stride_px: STRIDE_PX,
            degrees: DEGREES,
            density: 1.0,
        }
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

/// The planes of layers in ever fewer bits, for two, four and eight of them.
pub(in crate::sweep) fn compressions(request: &Request<'_>) -> Vec<Setting> {
    let counts: &[u8] = if request.quick { &[4] } else { &[2, 4, 8] };
    let codings: &[(ColorFormat, u8, u8)] = &[
        (ColorFormat::Half, 16, 16),
        (ColorFormat::Root10, 14, 10),
        (ColorFormat::Root10, 12, 8),
        (ColorFormat::Root8, 12, 10),
        (ColorFormat::Root8, 12, 8),
        (ColorFormat::Linear8, 12, 8),
        (ColorFormat::Root8, 10, 8),
        (ColorFormat::Root8, 10, 7),
        (ColorFormat::Root8, 8, 6),
    ];
    let of_count = |&layers: &u8| {
        let layerings: &[Layering] = if request.quick {
            &[Layering::Optimal]
        } else {
            &[Layering::Optimal, Layering::Merged, Layering::Quantiles]
        };
        layerings.iter().flat_map(move |&layering| {
            codings.iter().map(move |&(source, depth_bits, optical_depth_bits)| {
                let format = VolumeFormat { layers, layering, depth_bits, optical_depth_bits, source };
                let value = format!("{}:{layers} {source:?}/{depth_bits}/{optical_depth_bits}", layering.name());
                Setting { format, ..Setting::new(value) }
            })
        })
    };
    counts.iter().flat_map(of_count).collect()
}
