//! A recorded session with a few bytes changed, a hundred thousand times: neither state machine panics, hangs or
//! holds more than it may.

use warplight_tests::hostile::{client_hears, recorded, server_hears};

const MUTATIONS: u64 = 100_000;
/// What both machines may hold beyond the process at rest; a length of 4 GB taken at its word would be more.
const MOST_GROWTH_BYTES: u64 = 64 << 20;

/// splitmix64 (Steele 2014): the same mutations on every machine.
struct Random(u64);

impl Random {
    fn next(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut bits = self.0;
        bits = (bits ^ (bits >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        bits = (bits ^ (bits >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        bits ^ (bits >> 31)
    }

    fn below(&mut self, bound: usize) -> usize {
        (self.next() % bound.max(1) as u64) as usize
    }
}

fn mutate(bytes: &mut Vec<u8>, random: &mut Random) {
    for _ in 0..=random.below(4) {
        let at = random.below(bytes.len());
        let until = (at + random.below(64)).min(bytes.len());
        match random.below(7) {
            0 if at < bytes.len() => bytes[at] ^= 1 << random.below(8),
            1 if at < bytes.len() => bytes[at] = random.next() as u8,
            2 => drop(bytes.drain(at..until)),
            3 => bytes.truncate(at),
            4 => {
                let piece = bytes[at..until].to_vec();
                let to = random.below(bytes.len());
                bytes.splice(to..to, piece);
            }
            5 => drop(bytes.splice(at..at, (random.next() as u32).to_le_bytes())),
            _ if at + 4 <= bytes.len() => bytes[at..at + 4].copy_from_slice(&[0xff, 0xff, 0xff, 0x7f]),
            _ => {}
        }
    }
}

/// Most memory that this process ever had, where the system tells.
fn peak_bytes() -> Option<u64> {
    let status = std::fs::read_to_string("/proc/self/status").ok()?;
    let line = status.lines().find(|line| line.starts_with("VmHWM:"))?;
    Some(line.split_whitespace().nth(1)?.parse::<u64>().ok()? << 10)
}

#[test]
fn a_mutated_session_never_panics_hangs_or_grows() {
    let (up, down) = recorded();
    let before = peak_bytes();
    let mut random = Random(1);
    for number in 0..MUTATIONS {
        let mut bytes = if number % 2 == 0 { up.clone() } else { down.clone() };
        mutate(&mut bytes, &mut random);
        let longest = 1 + random.below(2000);
        let cut = || 1 + random.below(longest);
        if number % 2 == 0 { server_hears(&bytes, cut) } else { client_hears(&bytes, cut) }
    }
    match (before, peak_bytes()) {
        (Some(before), Some(after)) => assert!(after - before <= MOST_GROWTH_BYTES, "{before} to {after} bytes"),
        _ => eprintln!("skipped: this system does not tell how much memory a process had"),
    }
}
