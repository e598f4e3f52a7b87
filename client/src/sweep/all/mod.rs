//! `sweep all`: every knob, one after the other, as one page, one document and one table.
//!
//! What comes out is a folder: `index.html`, a page that stands alone ([`page`]); `accuracy.md`, the document that
//! `docs/accuracy.md` is ([`markdown`]); `accuracy.json`, all sweeps in the form of `schema.json` beside this file; and,
//! as each knob is done, its own JSON and plots. A knob that cannot be turned on the scene that was asked for is named
//! with the reason. Date and machine are part of [`Conditions`]: times mean nothing without them.

mod date;
mod machine;
mod markdown;
mod page;
#[cfg(test)]
mod schema;

pub use date::date_from_unix;
pub use machine::Machine;

use super::{Knob, Request, SCHEMA, Sweep, SweepError};
use crate::report::{rounded_json, write_whole};
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::io;
use std::path::{Path, PathBuf};

/// Under what all knobs were turned.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Conditions {
    /// The day, in UTC.
    pub date: String,
    /// On what.
    pub machine: Machine,
    /// Version of the program.
    pub version: String,
    /// Version of the wire.
    pub wire_version: u16,
    /// Width and height in pixels.
    pub size: [u32; 2],
    /// Timed runs of each setting.
    pub runs: u32,
    /// Whether settings and scenes were fewer.
    pub quick: bool,
    /// The scene that was asked for; `null`: those of each knob.
    pub scene: Option<String>,
    /// Name or path of the head trace; `null`: the built-in one.
    pub trace: Option<String>,
}

impl Conditions {
    /// The command that measures one knob again.
    pub fn command(&self, knob: &str) -> String {
        let [width, height] = self.size;
        let mut command = format!("warplight-client sweep {knob} --size {width}x{height} --runs {}", self.runs);
        if self.quick {
            command += " --quick";
        }
        for (flag, value) in [("scene", &self.scene), ("trace", &self.trace)] {
            if let Some(value) = value {
                command += &format!(" --{flag} {value}");
            }
        }
        command
    }
}

/// Every knob turned: the JSON document.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Sweeps {
    /// [`SCHEMA`].
    pub schema: u32,
    /// When, where, how thoroughly.
    pub conditions: Conditions,
    /// What each knob took to be measured, in seconds.
    pub seconds: BTreeMap<String, f64>,
    /// Knobs that could not be turned on the scene, and why.
    pub skipped: BTreeMap<String, String>,
    /// The sweeps, in the order of the knobs.
    pub sweeps: Vec<Sweep>,
}

impl Sweeps {
    /// Turns all `knobs`. `progress` is told the knob and which part of all is done; `done` gets each sweep, and how
    /// many seconds it took.
    ///
    /// # Errors
    /// What stops a sweep, but that a knob cannot be turned on a scene that was asked for; what `done` says.
    pub fn measure(
        knobs: &[&'static Knob],
        request: &Request<'_>,
        conditions: Conditions,
        progress: &mut dyn FnMut(&str, f64),
        done: &mut dyn FnMut(&Sweep, f64) -> Result<(), SweepError>,
    ) -> Result<Sweeps, SweepError> {
        let mut all =
            Sweeps { schema: SCHEMA, conditions, seconds: BTreeMap::new(), skipped: BTreeMap::new(), sweeps: vec![] };
        for (number, knob) in knobs.iter().enumerate() {
            let scene = all.conditions.scene.as_deref();
            let scenes = knob.scenes_of(request, scene).unwrap_or_default();
            progress(knob.name, number as f64 / knobs.len() as f64);
            let start = (request.now)();
            let swept = knob.sweep(request, scene, &mut |at, step, steps| {
                let before = scenes.iter().position(|scene| *scene == at).unwrap_or(0) as f64;
                let of_knob = (before + step as f64 / steps.max(1) as f64) / scenes.len().max(1) as f64;
                progress(knob.name, (number as f64 + of_knob) / knobs.len() as f64);
            });
            let sweep = match swept {
                Ok(sweep) => sweep,
                // This knob has nothing to turn there; others have.
                Err(why @ (SweepError::Scene(_) | SweepError::UnknownScene { .. })) if scene.is_some() => {
                    all.skipped.insert(knob.name.to_owned(), why.to_string());
                    continue;
                }
                Err(why) => return Err(why),
            };
            let secs = ((request.now)() - start).as_secs_f64();
            done(&sweep, secs)?;
            all.seconds.insert(knob.name.to_owned(), secs);
            all.sweeps.push(sweep);
        }
        Ok(all)
    }

    /// The JSON document, ending with a line break.
    ///
    /// # Errors
    /// What serde_json refuses; nothing in a sweep is of that kind.
    pub fn to_json(&self) -> Result<String, serde_json::Error> {
        rounded_json(self)
    }

    /// Writes `index.html`, `accuracy.md` and `accuracy.json`; returns their paths.
    ///
    /// # Errors
    /// What the operating system says.
    pub fn write(&self, folder: &Path) -> io::Result<Vec<PathBuf>> {
        std::fs::create_dir_all(folder)?;
        let files = [
            ("index.html", page::page(self)),
            ("accuracy.md", markdown::document(self)),
            ("accuracy.json", self.to_json()?),
        ];
        let mut paths = Vec::new();
        for (name, text) in files {
            paths.push(folder.join(name));
            write_whole(&folder.join(name), text.as_bytes())?;
        }
        Ok(paths)
    }
}

#[cfg(test)]
mod tests;
