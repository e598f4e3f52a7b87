//! The text of a Mitsuba scene to one tree of elements.
//!
//! roxmltree reads the XML; here `<default>` and `$name`, `<include>`, `<path>`, `<alias>` and the names of older
//! versions are dealt with, in the order of the document, as Mitsuba does. Parameters and folders are shared by all
//! files of a scene.
//!
//! Limits: entities cannot be declared (no DTD), so nothing grows out of itself but parameters, whose result is
//! limited; nesting, includes, elements, attributes and bytes are counted before they are followed. See `untrusted`.

use super::super::SceneError;
use super::super::picture::one_line;
use super::super::untrusted::{
    MAX_ATTRIBUTE_BYTES, MAX_INCLUDES, MAX_XML_BYTES, MAX_XML_DEPTH, MAX_XML_ELEMENTS, check_limit, read_file,
};
use super::node::{File, Node, Place};
use std::collections::HashMap;
use std::path::{Path, PathBuf};
use std::rc::Rc;

/// Every element that a scene may have; the others are errors.
const TAGS: [&str; 30] = [
    "scene",
    "bsdf",
    "texture",
    "shape",
    "emitter",
    "sensor",
    "integrator",
    "film",
    "sampler",
    "rfilter",
    "medium",
    "phase",
    "volume",
    "spectrum",
    "rgb",
    "float",
    "integer",
    "boolean",
    "string",
    "point",
    "vector",
    "transform",
    "translate",
    "rotate",
    "scale",
    "lookat",
    "matrix",
    "ref",
    "animation",
    "null",
];

/// A scene's elements and where it looks for files.
#[derive(Debug)]
pub(super) struct Tree {
    pub(super) root: Node,
    /// Other names of ids.
    pub(super) aliases: HashMap<String, String>,
    folders: Vec<PathBuf>,
}

impl Tree {
    /// Reads a file and all that it includes.
    pub(super) fn read(path: &Path) -> Result<Tree, SceneError> {
        let reader = Reader::default();
        let text = reader.text(path)?;
        reader.tree(path, &text)
    }

    /// As [`Tree::read`], from a text.
    #[cfg(test)]
    pub(super) fn from_text(path: &Path, text: &str) -> Result<Tree, SceneError> {
        Reader::default().tree(path, text)
    }

    /// The path of a file that an element names: beside the element's own file, in a `<path>`, or beside the scene.
    pub(super) fn find(&self, place: &Place, name: &str) -> PathBuf {
        find(&self.folders, place, name)
    }
}

fn find(folders: &[PathBuf], place: &Place, name: &str) -> PathBuf {
    let beside = place.file.folder.join(name);
    if beside.exists() {
        return beside;
    }
    // The latest <path> comes first.
    folders.iter().rev().map(|folder| folder.join(name)).find(|path| path.exists()).unwrap_or(beside)
}

#[derive(Default)]
struct Reader {
    parameters: HashMap<String, String>,
    aliases: HashMap<String, String>,
    folders: Vec<PathBuf>,
    including: Vec<PathBuf>,
    elements: u64,
}

impl Reader {
    fn text(&self, path: &Path) -> Result<String, SceneError> {
        String::from_utf8(read_file(path, MAX_XML_BYTES)?).map_err(|error| SceneError::Malformed {
            file: path.display().to_string(),
            reason: format!("expected UTF-8 text, found another byte at {}", error.utf8_error().valid_up_to()),
        })
    }

    fn tree(mut self, path: &Path, text: &str) -> Result<Tree, SceneError> {
        self.folders.push(path.parent().unwrap_or(Path::new("")).to_owned());
        let root = self.file(path, text)?;
        if root.tag != "scene" {
            return Err(root.error("a file whose outermost element is <scene>", format_args!("<{}>", root.tag)));
        }
        Ok(Tree { root, aliases: self.aliases, folders: self.folders })
    }

    /// The outermost element of a file.
    fn file(&mut self, path: &Path, text: &str) -> Result<Node, SceneError> {
        let name = path.display().to_string();
        check_limit(&name, "files that include each other", MAX_INCLUDES as u64, self.including.len() as u64 + 1)?;
        self.including.push(path.to_owned());
        // More elements than we would keep are refused by the parser already.
        let options = roxmltree::ParsingOptions { nodes_limit: 4 * MAX_XML_ELEMENTS as u32, ..Default::default() };
        check_tags(&name, text)?;
        let document = roxmltree::Document::parse_with_options(text, options).map_err(|error| {
            let position = error.pos();
            let (line, column) = (position.row as usize, position.col as usize);
            SceneError::Syntax { file: name.clone(), line, column, message: one_line(&error.to_string()) }
        })?;
        let file = Rc::new(File { name, folder: path.parent().unwrap_or(Path::new("")).to_owned() });
        let starts: Vec<usize> = std::iter::once(0).chain(text.match_indices('\n').map(|(at, _)| at + 1)).collect();
        let root = document.root_element();
        let mut context = Context { file, text, starts, is_old: false };
        let place = context.place(&root);
        if let Some(version) = root.attribute("version") {
            let major: Option<u32> = version.split('.').next().and_then(|major| major.parse().ok());
            match major {
                Some(major @ 0..=3) => context.is_old = major < 3,
                _ => {
                    let found = version.escape_debug();
                    return Err(place.error(format_args!("<scene>: expected a version up to 3, found '{found}'")));
                }
            }
        }
        let mut nodes = Vec::new();
        self.element(&context, root, 1, &mut nodes)?;
        self.including.pop();
        nodes.pop().ok_or_else(|| place.error("expected <scene>"))
    }

    /// Appends what an element of the file comes to: nothing, itself, or the elements of another file.
    fn element(
        &mut self,
        context: &Context,
        element: roxmltree::Node,
        depth: usize,
        into: &mut Vec<Node>,
    ) -> Result<(), SceneError> {
        let place = context.place(&element);
        self.elements += 1;
        check_limit(&context.file.name, "elements", MAX_XML_ELEMENTS, self.elements)?;
        check_limit(&context.file.name, "levels of elements", MAX_XML_DEPTH as u64, depth as u64)?;
        let name = element.tag_name().name();
        let mut attributes = Vec::new();
        for attribute in element.attributes() {
            let mut value = self.with_parameters(&place, attribute.value())?;
            if context.is_old && attribute.name() == "name" && name != "default" {
                value = snake_case(&value);
            }
            attributes.push((attribute.name().to_owned(), value));
        }
        let get = |wanted: &str| -> Result<String, SceneError> {
            let found = attributes.iter().find(|(known, _)| known == wanted);
            let missing = || place.error(format_args!("<{name}>: expected the attribute '{wanted}', found none"));
            found.map(|(_, value)| value.clone()).ok_or_else(missing)
        };
        match name {
            "default" => {
                let (name, value) = (get("name")?, get("value")?);
                self.parameters.entry(name).or_insert(value);
                return Ok(());
            }
            "path" => {
                let folder = context.file.folder.join(get("value")?);
                self.folders.push(folder);
                return Ok(());
            }
            "alias" => {
                let (id, other) = (get("id")?, get("as")?);
                self.aliases.insert(other, id);
                return Ok(());
            }
            "include" => {
                let path = find(&self.folders, &place, &get("filename")?);
                if self.including.contains(&path) {
                    let path = path.display();
                    return Err(place.error(format_args!(
                        "<include>: expected a file that does not include itself, found '{path}'"
                    )));
                }
                let text = self.text(&path)?;
                let root = self.file(&path, &text)?;
                if root.tag == "scene" {
                    into.extend(root.children)
                } else {
                    into.push(root)
                }
                return Ok(());
            }
            _ => {}
        }
        let tag = if name == "lookAt" { "lookat" } else { name };
        let Some(&tag) = TAGS.iter().find(|&&known| known == tag) else {
            let found: String = name.chars().take(40).collect();
            let expected = "an element of a Mitsuba scene, such as <shape>, <bsdf>, <emitter> or <float>";
            return Err(place.error(format_args!("expected {expected}, found <{}>", found.escape_debug())));
        };
        let mut children = Vec::new();
        for child in element.children().filter(roxmltree::Node::is_element) {
            self.element(context, child, depth + 1, &mut children)?;
        }
        into.push(Node { tag, attributes, children, place });
        Ok(())
    }

    /// A text with the values of the parameters that it names by `$name`.
    fn with_parameters(&self, place: &Place, text: &str) -> Result<String, SceneError> {
        let mut text = text.to_owned();
        // A value may name parameters in its turn.
        for _ in 0..MAX_NESTED_PARAMETERS {
            let Some(at) = text.find('$') else { return Ok(text) };
            let rest = &text[at + 1..];
            let known = self.parameters.iter().filter(|(name, _)| rest.starts_with(name.as_str()));
            // The longest name that fits, so that $integrator is not $int.
            let Some((name, value)) = known.max_by_key(|(name, _)| name.len()) else {
                let found: String = rest.chars().take_while(|c| c.is_alphanumeric() || *c == '_').take(40).collect();
                return Err(
                    place.error(format_args!("expected a parameter that a <default> defines, found '${found}'"))
                );
            };
            let longer = (text.len() + value.len()) as u64;
            check_limit(&place.file.name, "bytes of an attribute", MAX_ATTRIBUTE_BYTES, longer)?;
            text = format!("{}{value}{}", &text[..at], &rest[name.len()..]);
        }
        Err(place.error(format_args!("expected at most {MAX_NESTED_PARAMETERS} parameters in one attribute")))
    }
}

/// Parameters that one attribute may come to.
const MAX_NESTED_PARAMETERS: usize = 64;

/// A file while it is read.
struct Context<'a> {
    file: Rc<File>,
    text: &'a str,
    /// Where lines begin.
    starts: Vec<usize>,
    /// Names are in camel case.
    is_old: bool,
}

impl Context<'_> {
    fn place(&self, element: &roxmltree::Node) -> Place {
        let at = element.range().start;
        let line = self.starts.partition_point(|&start| start <= at);
        let start = self.starts.get(line.saturating_sub(1)).copied().unwrap_or(0);
        let column = self.text.get(start..at).map_or(0, |before| before.chars().count()) + 1;
        Place { file: self.file.clone(), line, column }
    }
}

/// Refuses what the parser, whose time grows with the square of either, would take hours for: elements with very
/// many attributes, and very many namespaces.
fn check_tags(file: &str, text: &str) -> Result<(), SceneError> {
    let mut rest = text;
    let skip = |rest: &str, end: &str| rest.find(end).map_or(rest.len(), |at| at + end.len());
    while let Some(at) = rest.find('<') {
        rest = &rest[at..];
        let length = if rest.starts_with("<!--") {
            skip(rest, "-->")
        } else if rest.starts_with("<![CDATA[") {
            skip(rest, "]]>")
        } else {
            let (mut quote, mut attributes, mut length) = (None, 0, rest.len());
            for (at, byte) in rest.bytes().enumerate() {
                match (quote, byte) {
                    (Some(open), _) if open == byte => quote = None,
                    (Some(_), _) => {}
                    (None, b'"' | b'\'') => quote = Some(byte),
                    (None, b'=') => attributes += 1,
                    (None, b'>') => {
                        length = at + 1;
                        break;
                    }
                    _ => {}
                }
            }
            check_limit(file, "attributes of an element", MAX_ATTRIBUTES, attributes)?;
            length
        };
        rest = &rest[length..];
    }
    check_limit(file, "namespaces", MAX_ATTRIBUTES, text.matches("xmlns").count() as u64)
}

/// Most attributes of an element, and namespaces of a file: elements have less than ten, and scenes no namespace.
const MAX_ATTRIBUTES: u64 = 64;

/// `toWorld` to `to_world`, `intIOR` to `int_ior`.
fn snake_case(name: &str) -> String {
    let mut snake = String::with_capacity(name.len() + 4);
    let mut after_lower = false;
    for letter in name.chars() {
        if letter.is_ascii_uppercase() && after_lower {
            snake.push('_');
        }
        after_lower = letter.is_ascii_lowercase() || letter.is_ascii_digit();
        snake.push(letter.to_ascii_lowercase());
    }
    snake
}

#[cfg(test)]
mod tests {
    use super::*;

    fn tree(text: &str) -> Result<Tree, SceneError> {
        Tree::from_text(Path::new("x.xml"), text)
    }

    fn error(text: &str) -> String {
        let line = tree(text).unwrap_err().to_string();
        assert!(!line.contains('\n'), "{line}");
        line
    }

    #[test]
    fn parameters_are_put_in_and_the_first_default_counts() {
        let text = "<scene version='3.0.0'><default name='a' value='1'/><default name='ab' value='2$a'/>\
                    <default name='a' value='9'/><float name='x' value='$ab,$a'/></scene>";
        assert_eq!(tree(text).unwrap().root.children[0].attribute("value"), Some("21,1"));
        assert_eq!(
            error("<scene version='3.0.0'>\n  <float name='x' value='$spp'/></scene>"),
            "x.xml: line 2, column 3: expected a parameter that a <default> defines, found '$spp'"
        );
    }

    #[test]
    fn older_names_are_read_as_todays() {
        let text = "<scene version='2.0.0'><shape type='obj'><transform name='toWorld'><lookAt/></transform>\
                    <string name='intIOR' value='bk7'/></shape></scene>";
        let root = tree(text).unwrap().root;
        let shape = &root.children[0];
        assert_eq!((shape.children[0].name(), shape.children[1].name()), ("to_world", "int_ior"));
        assert_eq!(shape.children[0].children[0].tag, "lookat");
        assert!(error("<scene version='4.0.0'/>").contains("expected a version up to 3, found '4.0.0'"));
    }

    #[test]
    fn an_unknown_element_is_named_with_its_place() {
        assert_eq!(
            error("<scene version='3.0.0'>\n<bsdf type='diffuse'>\n  <colour value='1'/></bsdf></scene>"),
            "x.xml: line 3, column 3: expected an element of a Mitsuba scene, such as <shape>, <bsdf>, <emitter> or \
             <float>, found <colour>"
        );
    }

    #[test]
    fn what_is_no_xml_is_one_line() {
        for text in ["", "hello", "<scene", "<scene></scen>", "<a/><b/>", "<scene version='3.0.0'><float/>", "\u{0}"] {
            assert!(error(text).starts_with("x.xml: "), "{text}");
        }
        assert!(error("<bsdf type='diffuse'/>").contains("outermost element is <scene>"));
    }

    #[test]
    fn entities_that_grow_and_deep_trees_are_refused() {
        let laughs = "<!DOCTYPE s [<!ENTITY a 'ha'><!ENTITY b '&a;&a;'>]><scene version='3.0.0'>&b;</scene>";
        assert!(error(laughs).contains("DTD"), "{}", error(laughs));
        let deep = |levels: usize| "<scene version='3.0.0'>".repeat(levels) + &"</scene>".repeat(levels);
        assert!(tree(&deep(60)).is_ok());
        assert!(error(&deep(100)).contains("levels of elements: at most 64"));
        assert!(error(&deep(200_000)).contains("levels of elements: at most 64"));
        let many: String = (0..100_000).map(|index| format!(" a{index}='<>'")).collect();
        assert!(error(&format!("<scene version='3.0.0'{many}/>")).contains("attributes of an element: at most 64"));
        let many = "<scene xmlns='a'>".repeat(100_000);
        assert!(error(&many).contains("namespaces: at most 64"));
        assert!(tree("<scene version='3.0.0'><!-- it's <a> = -->\n<float value='=\"='/></scene>").is_ok());
        let mut parameters = "<default name='a0' value='xxxxxxxxxxxxxxxx'/>".to_owned();
        for level in 1..30 {
            let value = format!("$a{}_", level - 1).repeat(2);
            parameters += &format!("<default name='a{level}' value='{value}'/>");
        }
        let grown = format!("<scene version='3.0.0'>{parameters}<float value='$a29'/></scene>");
        assert!(error(&grown).contains("at most"), "{}", error(&grown));
        assert!(
            error("<scene version='3.0.0'><default name='a' value='1'/><default name='' value='$'/></scene>")
                .contains('$')
        );
    }

    #[test]
    fn files_are_included_once_in_a_row_and_found_by_path() {
        let folder = tempfile::tempdir().unwrap();
        let write = |name: &str, text: &str| std::fs::write(folder.path().join(name), text).unwrap();
        std::fs::create_dir(folder.path().join("parts")).unwrap();
        write(
            "parts/one.xml",
            "<scene version='3.0.0'><default name='n' value='7'/><include filename='two.xml'/></scene>",
        );
        write("parts/two.xml", "<bsdf type='diffuse' id='b$n'/>");
        let main = "<scene version='3.0.0'><path value='parts'/><include filename='one.xml'/><integer name='n' value='$n'/></scene>";
        write("main.xml", main);
        let tree = Tree::read(&folder.path().join("main.xml")).unwrap();
        assert_eq!(tree.root.children[0].attribute("id"), Some("b7"));
        assert_eq!(tree.root.children[1].attribute("value"), Some("7"));
        write("parts/two.xml", "<scene version='3.0.0'><include filename='one.xml'/></scene>");
        let line = Tree::read(&folder.path().join("main.xml")).unwrap_err().to_string();
        assert!(line.contains("two.xml: line 1") && line.contains("does not include itself"), "{line}");
        assert!(Tree::read(&folder.path().join("nowhere.xml")).unwrap_err().to_string().contains("No such file"));
    }
}
