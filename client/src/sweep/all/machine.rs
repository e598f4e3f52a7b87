//! On what something was measured: a time without its machine says nothing.

use crate::lanes::Level;
use serde::{Deserialize, Serialize};

/// The machine that this program runs on, as far as it says.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Machine {
    /// Name of the processor.
    pub cpu: String,
    /// Cores that this process may use.
    pub cores: usize,
    /// The widest vectors that kernels use here.
    pub vectors: String,
    /// The operating system.
    pub os: String,
}

impl Machine {
    /// This one. What it does not say is `unknown`, never a reason to fail.
    pub fn here() -> Machine {
        let read = |path: &str| std::fs::read_to_string(path).unwrap_or_default();
        let kernel = read("/proc/sys/kernel/osrelease");
        Machine {
            cpu: cpu_of(&read("/proc/cpuinfo")),
            cores: std::thread::available_parallelism().map_or(1, usize::from),
            vectors: Level::default().name().to_owned(),
            os: format!("{} {} {}", std::env::consts::OS, std::env::consts::ARCH, kernel.trim()).trim().to_owned(),
        }
    }
}

impl std::fmt::Display for Machine {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let Machine { cpu, cores, vectors, os } = self;
        let plural = if *cores == 1 { "" } else { "s" };
        write!(f, "{cpu}, {cores} core{plural}, vectors {vectors}, {os}")
    }
}

/// The first model that Linux lists.
fn cpu_of(cpuinfo: &str) -> String {
    let model = |line: &str| {
        let (key, value) = line.split_once(':')?;
        (key.trim() == "model name").then(|| value.trim().to_owned())
    };
    cpuinfo.lines().find_map(model).unwrap_or_else(|| "unknown".to_owned())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_machine_is_named_in_one_line_whatever_it_says() {
        let cpuinfo = "processor\t: 0\nmodel name\t: A CPU @ 2 GHz\nprocessor\t: 1\nmodel name\t: another\n";
        assert_eq!(cpu_of(cpuinfo), "A CPU @ 2 GHz");
        assert_eq!(cpu_of("Features : fp\n"), "unknown");
        let here = Machine::here();
        assert!(here.cores >= 1 && !here.to_string().contains('\n') && !here.os.is_empty(), "{here}");
    }
}
