//! Mitsuba scenes (Jakob et al. 2022), .xml of versions up to 3, to a part of a scene.
//!
//! `xml` makes one tree of elements of all files; here it is walked: shapes first, in the order of the file, then
//! lights, sensors and the integrator. What `docs/scene-format.md` lists is read; of what else Mitsuba has, each kind
//! is left out or approximated with one warning that names who asked for it. An element, a plugin or a value that
//! Mitsuba has not either is an error with file, line and column. Parameters that nothing here asks for are named, too.
//!
//! Conventions that differ: cameras (`sensor`), latitude-longitude images (`emitter`), textures of green in normal
//! maps (`bsdf`), which side of a triangle is outside (`shape`). Texture coordinates do not: v = 0 is the first row
//! of an image in Mitsuba, too, so a picture on its `rectangle`, whose v runs with +Y, stands on its head.

mod bsdf;
mod emitter;
mod ior;
mod medium;
mod node;
mod primitives;
mod sensor;
mod shape;
mod spectrum;
#[cfg(test)]
mod tests;
mod transform;
mod value;
mod xml;

use super::{Environment, Material, Part, SceneError};
use glam::Vec3;
use node::{Node, Plugin};
use std::collections::{BTreeMap, HashMap};
use std::path::Path;
use xml::Tree;

/// Reads a scene.
pub(super) fn load(path: &Path) -> Result<(Part, Option<Environment>), SceneError> {
    compose(&Tree::read(path)?)
}

fn compose(tree: &Tree) -> Result<(Part, Option<Environment>), SceneError> {
    let mut loader = Loader {
        tree,
        ids: HashMap::new(),
        part: Part::default(),
        environment: None,
        textures: HashMap::new(),
        materials: HashMap::new(),
        media: HashMap::new(),
        image_bytes: 0,
        notes: BTreeMap::new(),
    };
    loader.collect_ids(&tree.root)?;
    loader.scene(&tree.root)?;
    let file = &tree.root.place.file.name;
    let lines = loader.notes.iter().map(|(what, users)| {
        let named: Vec<_> = users.iter().take(NAMED).map(|user| format!("'{}'", user.escape_debug())).collect();
        let more = users.len().saturating_sub(NAMED);
        let more = if more > 0 { format!(" and {more} more") } else { String::new() };
        format!("{file}: {what}: {}{more}", named.join(", "))
    });
    loader.part.warnings.extend(lines.collect::<Vec<_>>());
    if loader.environment.is_none() && !loader.part.has_emission() {
        loader.part.warnings.push(format!("{file}: nothing emits light: lit from everywhere, as Mitsuba does"));
        loader.environment = Some(Environment::Constant(Vec3::ONE));
    }
    Ok((loader.part, loader.environment))
}

/// So many users of what is left out are named; the others are counted.
const NAMED: usize = 3;

/// What has been read so far.
struct Loader<'a> {
    tree: &'a Tree,
    ids: HashMap<&'a str, &'a Node>,
    part: Part,
    environment: Option<Environment>,
    /// Textures by their element and whether they are read as they are; `None` where they are left out.
    textures: HashMap<(*const Node, Option<bool>), Option<u32>>,
    /// Materials by their element, without emission.
    materials: HashMap<*const Node, Material>,
    /// Indices of media by their element.
    media: HashMap<*const Node, u32>,
    /// Of images and grids so far.
    image_bytes: u64,
    /// Who asked for what is left out.
    notes: BTreeMap<String, Vec<String>>,
}

impl<'a> Loader<'a> {
    fn collect_ids(&mut self, node: &'a Node) -> Result<(), SceneError> {
        if let Some(id) = node.attribute("id").filter(|_| node.tag != "ref")
            && let Some(first) = self.ids.insert(id, node)
        {
            let line = first.place.line;
            return Err(node.value_error(format_args!("an id that line {line} has not taken"), id));
        }
        node.children.iter().try_for_each(|child| self.collect_ids(child))
    }

    /// What a `<ref>` stands for; all other elements stand for themselves.
    fn resolve(&self, node: &'a Node) -> Result<&'a Node, SceneError> {
        if node.tag != "ref" {
            return Ok(node);
        }
        let id = node.required("id")?;
        let mut name = id;
        // An alias of an alias of an alias; more are a cycle.
        for _ in 0..16 {
            if let Some(&found) = self.ids.get(name) {
                return Ok(found);
            }
            match self.tree.aliases.get(name) {
                Some(other) => name = other,
                None => break,
            }
        }
        Err(node.value_error("the id of an element", id))
    }

    fn note(&mut self, what: impl Into<String>, user: &str) {
        let users = self.notes.entry(what.into()).or_default();
        if !users.iter().any(|known| known == user) {
            users.push(user.to_owned());
        }
    }

    /// Names parameters that nobody has asked for.
    fn note_unused(&mut self, plugin: &Plugin<'a>) {
        for child in plugin.unused() {
            let name = if child.name().is_empty() { format!("<{}>", child.tag) } else { format!("'{}'", child.name()) };
            let of = format!("{} of type '{}'", plugin.node.tag, plugin.node.kind());
            self.note(format!("the parameter {name} of a {of} is not used"), &plugin.node.label());
        }
    }

    fn scene(&mut self, root: &'a Node) -> Result<(), SceneError> {
        let of = |tag: &'static str| root.children.iter().filter(move |child| child.tag == tag);
        for child in &root.children {
            match child.tag {
                "shape" | "emitter" | "sensor" | "integrator" | "bsdf" | "texture" | "medium" | "ref" | "phase"
                | "film" | "sampler" | "rfilter" | "volume" | "spectrum" | "rgb" | "null" => {}
                other => {
                    return Err(
                        child.error("<shape>, <emitter>, <sensor>, <integrator> or <bsdf>", format_args!("<{other}>"))
                    );
                }
            }
        }
        of("shape").try_for_each(|shape| self.shape(shape))?;
        of("emitter").try_for_each(|emitter| self.emitter(emitter))?;
        of("sensor").try_for_each(|sensor| self.sensor(sensor))?;
        of("integrator").take(1).try_for_each(|integrator| self.integrator(integrator))
    }
}
