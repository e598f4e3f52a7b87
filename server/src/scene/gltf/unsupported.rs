//! What a glTF file asks for and does not get: one warning per feature, with the names of who asked.

use std::collections::BTreeMap;

/// Features that were met, each with the names of materials, meshes or nodes that use it.
#[derive(Debug, Default)]
pub(super) struct Unsupported {
    users: BTreeMap<&'static str, Vec<String>>,
}

impl Unsupported {
    /// Notes that `user` (empty for the file as a whole) asked for something. `what` says what happens.
    pub(super) fn note(&mut self, what: &'static str, user: &str) {
        let users = self.users.entry(what).or_default();
        if !user.is_empty() && !users.iter().any(|known| known == user) {
            users.push(user.to_owned());
        }
    }

    /// One line per feature.
    pub(super) fn warnings(self, file: &str) -> impl Iterator<Item = String> {
        self.users.into_iter().map(move |(what, users)| {
            if users.is_empty() {
                return format!("{file}: {what}");
            }
            let named: Vec<_> = users.iter().take(NAMED).map(|user| format!("'{}'", user.escape_debug())).collect();
            let more = users.len().saturating_sub(NAMED);
            let more = if more > 0 { format!(" and {more} more") } else { String::new() };
            format!("{file}: {what}: {}{more}", named.join(", "))
        })
    }
}

/// So many users are named; the others are counted.
const NAMED: usize = 3;

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_feature_is_one_line_however_many_ask_for_it() {
        let mut unsupported = Unsupported::default();
        for user in ["a", "b", "a", "c", "d", "e"] {
            unsupported.note("clear coats are left out", user);
        }
        unsupported.note("animations are not played", "");
        let lines: Vec<_> = unsupported.warnings("x.glb").collect();
        assert_eq!(
            lines,
            ["x.glb: animations are not played", "x.glb: clear coats are left out: 'a', 'b', 'c' and 2 more"]
        );
    }
}
