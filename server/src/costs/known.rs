//! The model that a run begins with, and what it leaves behind.

use super::{CostError, CostFile, CostModel};
use std::path::Path;
use warplight_protocol::budget::Chooser;

/// A model, whence it came, and whither its times go.
#[derive(Clone, Debug)]
pub struct KnownCosts {
    /// The model; where its own table of a kind is empty that of the built-in one.
    pub model: CostModel,
    /// What it is called in reports.
    pub name: String,
    /// What was wrong with a file that nobody named, in one line.
    pub warning: Option<String>,
    file: Option<CostFile>,
}

impl KnownCosts {
    /// That of a file that a person named; else the one that lies beside the scene; else the built-in one.
    ///
    /// # Errors
    /// A file that was named and is none.
    pub fn of(scene: Option<&str>, named: Option<&Path>) -> Result<KnownCosts, CostError> {
        let built_in =
            || KnownCosts { model: CostModel::built_in(), name: "built in".to_owned(), warning: None, file: None };
        let read = |file: CostFile| {
            let mut model = file.read()?;
            let other = CostModel::built_in();
            for (own, other) in [(&mut model.display, other.display), (&mut model.frame, other.frame)] {
                if own.points.is_empty() {
                    *own = other;
                }
            }
            let name = file.path().display().to_string();
            Ok(KnownCosts { model, name, warning: None, file: Some(file) })
        };
        if let Some(path) = named {
            return read(CostFile::at(path.to_owned()));
        }
        match scene.and_then(CostFile::beside).filter(CostFile::exists) {
            None => Ok(built_in()),
            Some(file) => Ok(read(file).unwrap_or_else(|error: CostError| {
                let warning = Some(format!("cost model: {error}; the built-in one is used"));
                KnownCosts { warning, ..built_in() }
            })),
        }
    }

    /// Takes over what a run has learnt, and writes it where it came from; nothing where that is no file.
    ///
    /// # Errors
    /// A file that cannot be written.
    pub fn refresh(&mut self, display: Option<&Chooser>, frame: Option<&Chooser>) -> Result<(), CostError> {
        display.into_iter().for_each(|chooser| self.model.display.refresh(chooser));
        frame.into_iter().for_each(|chooser| self.model.frame.refresh(chooser));
        self.model.machine = super::machine();
        self.file.as_ref().map_or(Ok(()), |file| file.write(&self.model))
    }
}

#[cfg(test)]
mod tests {
    use super::super::tests::model;
    use super::*;
    use warplight_protocol::budget::Tempo;

    #[test]
    fn a_model_beside_the_scene_is_used_and_refreshed_and_nothing_is_made_where_none_was() {
        let folder = tempfile::tempdir().unwrap();
        let scene = folder.path().join("s.toml");
        let scene = scene.to_str().unwrap();
        let files = || std::fs::read_dir(folder.path()).unwrap().count();
        let mut known = KnownCosts::of(Some(scene), None).unwrap();
        assert_eq!((known.name.as_str(), known.model == CostModel::built_in()), ("built in", true));
        known.refresh(None, None).unwrap();
        assert_eq!(files(), 0);

        let file = CostFile::beside(scene).unwrap();
        file.write(&model()).unwrap();
        let mut known = KnownCosts::of(Some(scene), None).unwrap();
        assert_eq!(known.model.display, model().display);
        assert_eq!(known.model.frame, CostModel::built_in().frame, "it has none of its own");
        let mut chooser = Chooser::new(known.model.display.front(|_| true), 9.0, 1.0, Tempo::DISPLAY).unwrap();
        for _ in 0..100 {
            chooser.measure(1.0, 8.0);
        }
        known.refresh(Some(&chooser), None).unwrap();
        let fine = file.read().unwrap().display.points.into_iter().find(|point| point.point == "fine").unwrap();
        assert!((fine.time_ms - 8.0).abs() < 0.1 && fine.error == 0.1);
    }

    #[test]
    fn a_damaged_model_is_told_and_left_alone_unless_it_was_named() {
        let folder = tempfile::tempdir().unwrap();
        let scene = folder.path().join("s.toml");
        let path = folder.path().join("s.toml.cost.json");
        std::fs::write(&path, "{\"schema\":7}").unwrap();
        let mut known = KnownCosts::of(scene.to_str(), None).unwrap();
        let warning = known.warning.clone().unwrap();
        assert!(warning.contains("s.toml.cost.json: schema: expected 1, found 7"), "{warning}");
        known.refresh(None, None).unwrap();
        assert_eq!(std::fs::read_to_string(&path).unwrap(), "{\"schema\":7}");
        assert!(KnownCosts::of(None, Some(&path)).is_err());
        assert!(KnownCosts::of(None, Some(&folder.path().join("none"))).is_err());
    }
}
