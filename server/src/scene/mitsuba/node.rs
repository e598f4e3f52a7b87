//! Elements of a Mitsuba file, after parameters, includes and old names are dealt with, and the values in them.

use super::super::SceneError;
use glam::DVec3;
use std::cell::RefCell;
use std::fmt::Display;
use std::ops::RangeInclusive;
use std::path::PathBuf;
use std::rc::Rc;

/// A file of the scene.
#[derive(Debug)]
pub(super) struct File {
    /// Name for messages.
    pub(super) name: String,
    /// Where relative names start.
    pub(super) folder: PathBuf,
}

/// Where in a file an element begins.
#[derive(Clone, Debug)]
pub(super) struct Place {
    pub(super) file: Rc<File>,
    /// From 1.
    pub(super) line: usize,
    /// In characters, from 1.
    pub(super) column: usize,
}

/// An element.
#[derive(Debug)]
pub(super) struct Node {
    pub(super) tag: &'static str,
    pub(super) attributes: Vec<(String, String)>,
    pub(super) children: Vec<Node>,
    pub(super) place: Place,
}

impl Node {
    pub(super) fn attribute(&self, name: &str) -> Option<&str> {
        self.attributes.iter().find(|(known, _)| known == name).map(|(_, value)| value.as_str())
    }

    /// An attribute that must be there.
    pub(super) fn required(&self, name: &str) -> Result<&str, SceneError> {
        self.attribute(name).ok_or_else(|| self.error(format_args!("the attribute '{name}'"), "none"))
    }

    /// The kind of plugin; empty where there is none.
    pub(super) fn kind(&self) -> &str {
        self.attribute("type").unwrap_or_default()
    }

    /// The name of the parameter that it is.
    pub(super) fn name(&self) -> &str {
        self.attribute("name").unwrap_or_default()
    }

    /// How warnings call it: its id, else its kind and line.
    pub(super) fn label(&self) -> String {
        match self.attribute("id") {
            Some(id) => id.to_owned(),
            None => {
                format!("{} in line {}", if self.kind().is_empty() { self.tag } else { self.kind() }, self.place.line)
            }
        }
    }

    /// An error of this element.
    pub(super) fn error(&self, expected: impl Display, found: impl Display) -> SceneError {
        let name = if self.name().is_empty() { String::new() } else { format!(" '{}'", self.name().escape_debug()) };
        self.place.error(format_args!("<{}>{name}: expected {expected}, found {found}", self.tag))
    }

    /// An error of one of its values.
    pub(super) fn value_error(&self, expected: impl Display, found: &str) -> SceneError {
        let found: String = found.chars().take(40).collect();
        self.error(expected, format_args!("'{}'", found.escape_debug()))
    }

    /// A finite number in an attribute, if it is there.
    pub(super) fn number_in(&self, attribute: &str) -> Result<Option<f64>, SceneError> {
        self.attribute(attribute).map(|text| self.number(text)).transpose()
    }

    /// A finite number.
    pub(super) fn number(&self, text: &str) -> Result<f64, SceneError> {
        let number: Option<f64> = text.trim().parse().ok().filter(|value: &f64| value.abs() <= LARGEST);
        number.ok_or_else(|| self.value_error("a number", text))
    }

    /// Numbers separated by commas or spaces.
    pub(super) fn numbers(&self, text: &str) -> Result<Vec<f64>, SceneError> {
        text.split([',', ' ', '\t', '\r', '\n']).filter(|word| !word.is_empty()).map(|word| self.number(word)).collect()
    }

    /// Three numbers: from `attribute`, where one number stands for all, or from x, y and z with a default.
    pub(super) fn triple(&self, attribute: &str, default: f64) -> Result<DVec3, SceneError> {
        if let Some(text) = self.attribute(attribute) {
            return match self.numbers(text)?[..] {
                [all] => Ok(DVec3::splat(all)),
                [x, y, z] => Ok(DVec3::new(x, y, z)),
                _ => Err(self.value_error("one or three numbers", text)),
            };
        }
        let axis = |name: &str| Ok::<f64, SceneError>(self.number_in(name)?.unwrap_or(default));
        Ok(DVec3::new(axis("x")?, axis("y")?, axis("z")?))
    }
}

impl Place {
    pub(super) fn error(&self, message: impl Display) -> SceneError {
        SceneError::Syntax {
            file: self.file.name.clone(),
            line: self.line,
            column: self.column,
            message: message.to_string(),
        }
    }
}

/// Largest number: its square is still an f32.
const LARGEST: f64 = 1e18;

/// An element with parameters, which keeps count of those that were asked for.
pub(super) struct Plugin<'a> {
    pub(super) node: &'a Node,
    asked: RefCell<Vec<bool>>,
}

impl<'a> Plugin<'a> {
    pub(super) fn new(node: &'a Node) -> Plugin<'a> {
        Plugin { node, asked: RefCell::new(vec![false; node.children.len()]) }
    }

    /// The parameter of this name.
    pub(super) fn child(&self, name: &str) -> Option<&'a Node> {
        let index = self.node.children.iter().position(|child| child.name() == name)?;
        self.asked.borrow_mut()[index] = true;
        Some(&self.node.children[index])
    }

    /// All children that satisfy something.
    pub(super) fn children(&self, wanted: impl Fn(&Node) -> bool) -> Vec<&'a Node> {
        let mut found = Vec::new();
        for (child, asked) in self.node.children.iter().zip(self.asked.borrow_mut().iter_mut()) {
            if wanted(child) {
                *asked = true;
                found.push(child);
            }
        }
        found
    }

    /// Parameters that change nothing in the mean of a picture.
    pub(super) fn without_effect(&self, names: &[&str]) {
        self.children(|child| names.contains(&child.name()));
    }

    /// Whether there is such a parameter; it counts as asked for.
    pub(super) fn has(&self, name: &str) -> bool {
        self.child(name).is_some()
    }

    /// The parameters that nobody has asked for.
    pub(super) fn unused(&self) -> Vec<&'a Node> {
        let asked = self.asked.borrow();
        self.node.children.iter().zip(asked.iter()).filter(|(_, asked)| !**asked).map(|(child, _)| child).collect()
    }

    fn typed(&self, name: &str, tags: &[&str]) -> Result<Option<&'a Node>, SceneError> {
        let Some(child) = self.child(name) else { return Ok(None) };
        if tags.contains(&child.tag) {
            return Ok(Some(child));
        }
        Err(child.error(format_args!("<{}>", tags.join("> or <")), format_args!("<{}>", child.tag)))
    }

    /// A number within a range.
    pub(super) fn float(&self, name: &str, default: f64, range: RangeInclusive<f64>) -> Result<f64, SceneError> {
        let Some(child) = self.typed(name, &["float", "integer"])? else { return Ok(default) };
        let text = child.required("value")?;
        let value = child.number(text)?;
        if range.contains(&value) {
            return Ok(value);
        }
        Err(child.value_error(format_args!("a number from {} to {}", range.start(), range.end()), text))
    }

    /// A whole number within a range; `None` where it is not there.
    pub(super) fn integer(&self, name: &str, range: RangeInclusive<i64>) -> Result<Option<i64>, SceneError> {
        let Some(child) = self.typed(name, &["integer"])? else { return Ok(None) };
        let text = child.required("value")?;
        let value = text.trim().parse().ok().filter(|value| range.contains(value));
        let expected = || format!("a whole number from {} to {}", range.start(), range.end());
        value.map(Some).ok_or_else(|| child.value_error(expected(), text))
    }

    /// True or false.
    pub(super) fn boolean(&self, name: &str, default: bool) -> Result<bool, SceneError> {
        let Some(child) = self.typed(name, &["boolean"])? else { return Ok(default) };
        match child.required("value")?.trim() {
            "true" | "True" => Ok(true),
            "false" | "False" => Ok(false),
            other => Err(child.value_error("true or false", other)),
        }
    }

    /// A text.
    pub(super) fn string(&self, name: &str) -> Result<Option<&'a str>, SceneError> {
        self.typed(name, &["string"])?.map(|child| child.required("value")).transpose()
    }

    /// A point or a direction.
    pub(super) fn point(&self, name: &str) -> Result<Option<DVec3>, SceneError> {
        self.typed(name, &["point", "vector"])?.map(|child| child.triple("value", 0.0)).transpose()
    }

    /// The element of a transform.
    pub(super) fn transform(&self, name: &str) -> Result<Option<&'a Node>, SceneError> {
        self.typed(name, &["transform"])
    }
}
