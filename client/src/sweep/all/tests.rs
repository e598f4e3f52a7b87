//! All knobs at once, small: documents have the form of their schema, the page stands alone.

use super::*;
use crate::report::page::html::check_nesting;
use crate::trace::Trace;
use schema::violations;
use serde_json::{Value, json};
use std::cell::Cell;
use std::time::Duration;
use warplight_protocol::ImageSize;

fn conditions(scene: Option<&str>) -> Conditions {
    Conditions {
        date: "2026-11-22".into(),
        machine: Machine { cpu: "a <CPU>".into(), cores: 2, vectors: "avx2".into(), os: "linux".into() },
        version: "0".into(),
        wire_version: 1,
        size: [96, 96],
        runs: 1,
        quick: true,
        scene: scene.map(str::to_owned),
        trace: None,
    }
}

/// Some knobs, of each kind that is cheap, on frames of 96x96.
fn measured(names: &[&str], scene: Option<&str>) -> Sweeps {
    let ticks = Cell::new(0);
    let now = || {
        ticks.set(ticks.get() + 1);
        Duration::from_millis(ticks.get())
    };
    let trace = Trace::built_in();
    let request = Request {
        size: ImageSize::new(96, 96),
        runs: 1,
        quick: true,
        trace: &trace,
        planes: None,
        reference_spp: 0,
        now: &now,
    };
    let knobs: Vec<&'static Knob> = names.iter().map(|name| Knob::named(name).unwrap()).collect();
    let mut parts = vec![0.0];
    let mut done = Vec::new();
    let all =
        Sweeps::measure(&knobs, &request, conditions(scene), &mut |_, part| parts.push(part), &mut |sweep, secs| {
            assert!(secs > 0.0);
            done.push(sweep.knob.clone());
            Ok(())
        });
    assert!(parts.is_sorted() && parts.iter().all(|part| (0.0..=1.0).contains(part)), "{parts:?}");
    let all = all.unwrap();
    assert_eq!(done, all.sweeps.iter().map(|sweep| sweep.knob.clone()).collect::<Vec<_>>());
    all
}

#[test]
fn all_sweeps_are_a_page_and_documents_that_have_the_form_of_their_schema() {
    let all = measured(&["depth-coding", "frame-age"], None);
    let folder = tempfile::tempdir().unwrap();
    let paths = all.write(folder.path()).unwrap();
    let [html, markdown, json] = [0, 1, 2].map(|file: usize| std::fs::read_to_string(&paths[file]).unwrap());
    let document: Value = serde_json::from_str(&json).unwrap();
    assert_eq!(violations(&document, "sweeps"), Vec::<String>::new());
    assert_eq!(serde_json::from_value::<Sweeps>(document.clone()).unwrap().to_json().unwrap(), json);
    let one: Value = serde_json::from_str(&all.sweeps[0].to_json().unwrap()).unwrap();
    assert_eq!(violations(&one, "sweep"), Vec::<String>::new());
    // The page.
    check_nesting(&html);
    assert!(!html.contains("http") && !html.contains("src=") && html.contains("a &lt;CPU&gt;"));
    assert_eq!(html.matches("<svg ").count(), 8, "four scenes of two knobs");
    for knob in ["depth-coding", "frame-age"] {
        assert!(html.contains(&format!("href=\"#{knob}\"")) && html.contains(&format!("id=\"{knob}\"")));
        let command = format!("warplight-client sweep {knob} --size 96x96 --runs 1 --quick");
        assert!(html.contains(&command) && markdown.contains(&format!("`{command}`")), "{markdown}");
        assert!(markdown.contains(&format!("\n## {knob}\n")) && markdown.contains(&format!("](#{knob})")));
    }
    // Of a circumstance every point, of a choice those on the front.
    let rows = markdown
        .lines()
        .filter(|line| crate::sweep::surface::SCENES.iter().any(|scene| line.starts_with(&format!("| {scene} | "))));
    let [coding, age] = [&all.sweeps[0], &all.sweeps[1]];
    assert_eq!(rows.count(), coding.points.iter().filter(|point| point.pareto).count() + age.points.len());
    assert!(!html.contains("NaN") && !markdown.contains("NaN"));
}

#[test]
fn a_knob_that_cannot_be_turned_on_the_scene_is_named_with_the_reason() {
    let all = measured(&["depth-coding", "density"], Some("mirror"));
    assert_eq!(all.sweeps.len(), 1);
    assert_eq!(all.skipped.keys().collect::<Vec<_>>(), ["density"]);
    for text in [page::page(&all), markdown::document(&all)] {
        assert!(
            text.contains(&all.skipped["density"].replace('\'', "&#39;")) || text.contains(&all.skipped["density"])
        );
    }
    assert!(all.conditions.command("x").ends_with("--quick --scene mirror"));
}

/// A schema that lets everything through would be none.
#[test]
fn what_is_not_as_the_schema_says_is_found() {
    let all = Sweeps {
        schema: SCHEMA,
        conditions: conditions(None),
        seconds: BTreeMap::from([("x".to_owned(), 1.0)]),
        skipped: BTreeMap::new(),
        sweeps: vec![Sweep {
            schema: SCHEMA,
            knob: "x".into(),
            scene: "all".into(),
            metric: "deg".into(),
            cost: crate::sweep::Cost::Time,
            size: [1, 2],
            runs: 3,
            points: vec![crate::sweep::Point {
                value: "v".into(),
                scene: "s".into(),
                time_ms: 1.0,
                time_spread_ms: 0.5,
                error: 0.25,
                bytes: 7,
                pareto: true,
                more: BTreeMap::from([("psnr_db".to_owned(), 30.0)]),
            }],
            resume: "r".into(),
        }],
    };
    let good: Value = serde_json::from_str(&all.to_json().unwrap()).unwrap();
    assert_eq!(violations(&good, "sweeps"), Vec::<String>::new());
    for (place, bad) in [
        ("/schema", json!(2)),
        ("/conditions/machine/cores", json!(0)),
        ("/conditions/size", json!([1])),
        ("/conditions/scene", json!(3)),
        ("/seconds/x", json!("long")),
        ("/sweeps/0/cost", json!("money")),
        ("/sweeps/0/points/0/error", Value::Null),
        ("/sweeps/0/points/0/bytes", json!(0.5)),
        ("/sweeps/0/points/0/psnr_db", json!("thirty")),
    ] {
        let mut document = good.clone();
        *document.pointer_mut(place).unwrap() = bad;
        let found = violations(&document, "sweeps");
        assert!(found.len() == 1 && found[0].contains(place), "{place}: {found:?}");
    }
    let mut document = good;
    document["sweeps"][0].as_object_mut().unwrap().remove("resume");
    document["guess"] = json!(1);
    let found = violations(&document, "sweeps");
    assert!(found.iter().any(|line| line.contains("resume")) && found.iter().any(|line| line.contains("guess")));
}
