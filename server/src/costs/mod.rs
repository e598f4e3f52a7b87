//! What each setting of client and server costs and how far off it is: tables that were measured, kept beside a scene.
//!
//! A budget (`warplight_protocol::budget`) needs the front of accuracy against time before the first frame. A
//! [`CostModel`] holds it for one scene: a table of points of the display, which the client chooses from, and one of
//! points of a frame, which the server does. Errors come from a sweep and stay what they are; times are refreshed by every
//! run with a budget, since they are the machine's. A point of a table that a release does not know is left out, one that
//! it knows and the table does not is never chosen.
//!
//! The file is JSON of version [`SCHEMA`]. That of the scene file `S` is `S.cost.json`; of a built-in scene it lies in
//! the user's cache (`$XDG_CACHE_HOME/warplight`, or `~/.cache/warplight`). Nobody writes one who was not asked: a sweep
//! with `--model` makes it, runs with a budget read it and refresh its times if it is there. Without one the model of
//! gallery is taken that comes with the program ([`CostModel::built_in`]), whose times are put right by the first
//! pictures. What is damaged is told in one line, and not used.
//!
//! Limits: one machine per file; on another one the ratios of the times are taken, and the name becomes its own.

mod file;
mod known;

pub use file::{CostError, CostFile, write_whole};
pub use known::KnownCosts;

use serde::{Deserialize, Serialize};
use warplight_protocol::budget::{Chooser, Front, PointCost};

/// Version of the document's form.
pub const SCHEMA: u32 = 1;
/// Most points of a table: what a file can claim is bounded.
const MAX_POINTS: usize = 256;

/// Measured points of one kind.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct CostTable {
    /// Unit of the errors.
    pub metric: String,
    /// Pixels of the display that times are for.
    pub pixels: u64,
    /// The points, in any order.
    pub points: Vec<PointCost>,
}

impl CostTable {
    /// The front of those points that `is_known` knows.
    pub fn front(&self, is_known: impl Fn(&str) -> bool) -> Front {
        Front::of(self.points.iter().filter(|point| is_known(&point.point)).cloned())
    }

    /// Takes over what a chooser has learnt about the times of its points.
    pub fn refresh(&mut self, chooser: &Chooser) {
        for (index, learnt) in chooser.points().iter().enumerate() {
            if let Some(point) = self.points.iter_mut().find(|point| point.point == learnt.point) {
                let refreshed = chooser.refreshed_ms(index);
                if refreshed.is_finite() && refreshed > 0.0 {
                    point.time_ms = refreshed;
                }
            }
        }
    }
}

/// The tables of one scene.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct CostModel {
    /// [`SCHEMA`].
    pub schema: u32,
    /// The scene they were measured on.
    pub scene: String,
    /// The machine whose times they are.
    pub machine: String,
    /// Points of a refresh of the display.
    #[serde(default)]
    pub display: CostTable,
    /// Points of a frame.
    #[serde(default)]
    pub frame: CostTable,
}

impl CostModel {
    /// One without points.
    pub fn empty(scene: &str) -> CostModel {
        CostModel {
            schema: SCHEMA,
            scene: scene.to_owned(),
            machine: machine(),
            display: CostTable::default(),
            frame: CostTable::default(),
        }
    }

    /// That of gallery, which comes with the program: `sweep display-point` and `sweep frame-point` at 512 and 384 pixels a
    /// side, on two cores. Points without nodes are left out: what they lose is seen where a view has glass, and the poses
    /// measured have little.
    pub fn built_in() -> CostModel {
        // A test reads it.
        CostModel::from_json(include_str!("gallery.cost.json")).unwrap_or_else(|_| CostModel::empty("gallery"))
    }

    /// Reads a document.
    ///
    /// # Errors
    /// Which field is not what was expected.
    pub fn from_json(text: &str) -> Result<CostModel, String> {
        #[derive(Deserialize)]
        struct Version {
            schema: u32,
        }
        // Told before anything else is read: a later version may have other fields.
        let Version { schema } = serde_json::from_str(text).map_err(|error| format!("schema: {error}"))?;
        if schema != SCHEMA {
            return Err(format!("schema: expected {SCHEMA}, found {schema}"));
        }
        let model: CostModel = serde_json::from_str(text).map_err(|error| error.to_string())?;
        for (name, table) in [("display", &model.display), ("frame", &model.frame)] {
            if table.points.len() > MAX_POINTS {
                let found = table.points.len();
                return Err(format!("{name}.points: expected at most {MAX_POINTS}, found {found}"));
            }
            if table.pixels == 0 && !table.points.is_empty() {
                return Err(format!("{name}.pixels: expected a number above 0, found 0"));
            }
            if let Some(bad) = table.points.iter().find(|point| !point.is_valid()) {
                let point = &bad.point;
                return Err(format!("{name}.points: '{point}': expected an error from 0 on and a time above 0"));
            }
        }
        Ok(model)
    }

    /// Whether it has the times of this machine.
    pub fn is_of_this_machine(&self) -> bool {
        self.machine == machine()
    }
}

/// The processor and how many of its cores there are, as the operating system names them.
pub fn machine() -> String {
    let cores = std::thread::available_parallelism().map_or(1, usize::from);
    let names = std::fs::read_to_string("/proc/cpuinfo").unwrap_or_default();
    let name = names.lines().find_map(|line| line.strip_prefix("model name")?.split_once(": "));
    let name = name.map_or(std::env::consts::ARCH, |(_, name)| name.trim());
    format!("{name}, {cores} cores")
}

#[cfg(test)]
mod tests {
    use super::*;
    use warplight_protocol::budget::Tempo;

    fn point(name: &str, error: f64, time_ms: f64) -> PointCost {
        PointCost { point: name.to_owned(), error, time_ms, spread_ms: 0.1 }
    }

    pub(super) fn model() -> CostModel {
        let points = vec![point("coarse", 0.2, 2.0), point("fine", 0.1, 4.0), point("beaten", 0.3, 5.0)];
        let display = CostTable { metric: "FLIP".to_owned(), pixels: 1000, points };
        CostModel { display, ..CostModel::empty("s") }
    }

    #[test]
    fn the_model_that_comes_with_the_program_has_fronts_of_both_kinds() {
        let built_in = CostModel::from_json(include_str!("gallery.cost.json")).unwrap();
        assert_eq!(built_in, CostModel::built_in());
        for table in [&built_in.display, &built_in.frame] {
            assert!(table.front(|_| true).points().len() >= 3, "{table:?}");
        }
    }

    #[test]
    fn what_a_chooser_has_learnt_is_in_the_table_and_errors_stay() {
        let mut model = model();
        let front = model.display.front(|name| name != "beaten");
        let mut chooser = Chooser::new(front, 20.0, 1.0, Tempo::DISPLAY).unwrap();
        for _ in 0..200 {
            chooser.measure(1.0, 12.0);
        }
        let before = model.display.clone();
        model.display.refresh(&chooser);
        let time_of = |name: &str| model.display.points.iter().find(|point| point.point == name).unwrap().time_ms;
        assert!((time_of("fine") - 12.0).abs() < 0.1 && (time_of("coarse") - 6.0).abs() < 0.1, "{model:?}");
        assert_eq!(time_of("beaten"), 5.0, "nobody measured it");
        let errors = |table: &CostTable| table.points.iter().map(|point| point.error).collect::<Vec<_>>();
        assert_eq!(errors(&model.display), errors(&before));
    }
}
