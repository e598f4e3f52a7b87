//! The scenes that come with the program: their files are in `scenes/`, their text is in the binary.

/// (name, text of its scene.toml); the first is the default.
const SCENES: [(&str, &str); 13] = [
    ("gallery", include_str!("../../../scenes/gallery/scene.toml")),
    ("cornell", include_str!("../../../scenes/cornell/scene.toml")),
    ("mirror-room", include_str!("../../../scenes/mirror-room/scene.toml")),
    ("chrome", include_str!("../../../scenes/chrome/scene.toml")),
    ("pool", include_str!("../../../scenes/pool/scene.toml")),
    ("glass", include_str!("../../../scenes/glass/scene.toml")),
    ("materials", include_str!("../../../scenes/materials/scene.toml")),
    ("lamp", include_str!("../../../scenes/lamp/scene.toml")),
    ("cube", include_str!("../../../scenes/cube/scene.toml")),
    ("cloud", include_str!("../../../scenes/cloud/scene.toml")),
    ("phantom", include_str!("../../../scenes/phantom/scene.toml")),
    ("shells", include_str!("../../../scenes/shells/scene.toml")),
    ("flight", include_str!("../../../scenes/flight/scene.toml")),
];

/// Their names.
pub(super) const NAMES: [&str; SCENES.len()] = {
    let mut names = [""; SCENES.len()];
    let mut index = 0;
    while index < SCENES.len() {
        names[index] = SCENES[index].0;
        index += 1;
    }
    names
};

/// The text of a built-in scene.
pub(super) fn text(name: &str) -> Option<&'static str> {
    SCENES.iter().find(|(known, _)| *known == name).map(|&(_, text)| text)
}
