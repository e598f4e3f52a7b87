//! What a receiver is willing to hold. Every length that a peer names is checked against these before
//! anything is allocated.

/// Limits on what a peer may ask for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Limits {
    /// Longest control message in bytes.
    pub control_bytes: usize,
    /// Longest strip message in bytes.
    pub strip_bytes: usize,
    /// Most pixels of a frame.
    pub frame_pixels: usize,
    /// Most memory for the planes of one frame, in bytes.
    pub frame_bytes: usize,
}

impl Limits {
    /// Longest message of any kind, in bytes.
    pub fn message_bytes(&self) -> usize {
        self.control_bytes.max(self.strip_bytes)
    }
}

impl Default for Limits {
    fn default() -> Limits {
        Limits {
            control_bytes: 64 << 10,
            strip_bytes: 32 << 20,
            frame_pixels: 4096 * 4096,
            // 2048 x 2048 pixels through seven nodes of 16 to 29 bytes, or one node of 4096 x 4096.
            frame_bytes: 768 << 20,
        }
    }
}
