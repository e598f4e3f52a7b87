//! Blosc 1, as OpenVDB uses it: blocks of bytes, shuffled by their place in a number and packed by LZ4.
//!
//! Format: github.com/Blosc/c-blosc, README_CHUNK_FORMAT.rst; LZ4: lz4_Block_format.md. Only LZ4, which is all
//! that OpenVDB writes. What is unpacked is exactly as long as expected, or an error.

/// Bytes of a chunk's head.
const HEAD_BYTES: usize = 16;
/// Flags of a chunk.
const SHUFFLED: u8 = 0x01;
const COPIED: u8 = 0x02;
const BIT_SHUFFLED: u8 = 0x04;
const NOT_SPLIT: u8 = 0x10;

/// Unpacks a chunk whose content has `expected` bytes.
pub(super) fn unpack(chunk: &[u8], expected: usize) -> Result<Vec<u8>, &'static str> {
    let head = chunk.get(..HEAD_BYTES).ok_or("fewer than 16 bytes")?;
    let (flags, type_size) = (head[2], usize::from(head[3]));
    let [content, block_size] = [word(head, 4)?, word(head, 8)?];
    if content != expected {
        return Err("another length than that of the node");
    }
    if flags & COPIED != 0 {
        return chunk.get(HEAD_BYTES..HEAD_BYTES + content).map(<[u8]>::to_vec).ok_or("too few bytes");
    }
    if flags & BIT_SHUFFLED != 0 {
        return Err("shuffled bits");
    }
    if flags >> 5 != 1 {
        return Err("another codec than LZ4");
    }
    if block_size == 0 || type_size == 0 {
        return Err("blocks or numbers without bytes");
    }
    let mut unpacked = Vec::with_capacity(content);
    for block in 0..content.div_ceil(block_size) {
        let size = block_size.min(content - block * block_size);
        // Blocks of full size may be packed in as many streams as a number has bytes (c-blosc, split_block).
        let splits = flags & NOT_SPLIT == 0 && size == block_size && type_size <= 16 && size / type_size >= 128;
        let streams = if splits { type_size } else { 1 };
        let mut at = word(chunk, HEAD_BYTES + 4 * block)?;
        let mut bytes = Vec::with_capacity(size);
        for _ in 0..streams {
            let length = word(chunk, at)?;
            let packed = at.checked_add(4).and_then(|at| chunk.get(at..at.checked_add(length)?));
            let packed = packed.ok_or("too few bytes")?;
            at += 4 + length;
            let end = bytes.len() + size / streams;
            if length == size / streams {
                bytes.extend_from_slice(packed);
            } else {
                lz4(packed, &mut bytes, end)?;
            }
        }
        if bytes.len() != size {
            return Err("a block of another length");
        }
        let count = size / type_size;
        if flags & SHUFFLED != 0 && type_size > 1 {
            // All first bytes of the numbers, then all second ones; what is left over is as it was.
            unpacked.extend((0..count * type_size).map(|at| bytes[at % type_size * count + at / type_size]));
            unpacked.extend_from_slice(&bytes[count * type_size..]);
        } else {
            unpacked.append(&mut bytes);
        }
    }
    Ok(unpacked)
}

fn word(bytes: &[u8], at: usize) -> Result<usize, &'static str> {
    let word = at.checked_add(4).and_then(|end| bytes.get(at..end)).ok_or("too few bytes")?;
    let word = u32::from_le_bytes([word[0], word[1], word[2], word[3]]);
    usize::try_from(word).map_err(|_| "too long")
}

/// Appends an LZ4 block to `out`, which must then have `end` bytes; matches reach back no further than the block.
fn lz4(packed: &[u8], out: &mut Vec<u8>, end: usize) -> Result<(), &'static str> {
    const DAMAGED: &str = "damaged LZ4";
    let start = out.len();
    let mut rest = packed.iter();
    let mut next = || rest.next().map(|&byte| usize::from(byte)).ok_or(DAMAGED);
    loop {
        let token = next()?;
        let long = |nibble: usize, next: &mut dyn FnMut() -> Result<usize, &'static str>| {
            let mut length = nibble;
            let mut more = nibble == 15;
            while more {
                let byte = next()?;
                length += byte;
                more = byte == 255;
            }
            Ok::<usize, &'static str>(length)
        };
        let literals = long(token >> 4, &mut next)?;
        if literals > end - out.len() {
            return Err(DAMAGED);
        }
        for _ in 0..literals {
            out.push(next()? as u8);
        }
        if out.len() == end {
            return Ok(());
        }
        let distance = next()? + 256 * next()?;
        let length = long(token & 15, &mut next)? + 4;
        if distance == 0 || distance > out.len() - start || length > end - out.len() {
            return Err(DAMAGED);
        }
        // Byte by byte: a match may overlap what it makes.
        for _ in 0..length {
            out.push(out[out.len() - distance]);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lz4_repeats_what_it_made() {
        // "abc" then 9 more bytes from 3 back, then the literal "xyzzy" (the example of the format's document style).
        let packed = [0x35, b'a', b'b', b'c', 3, 0, 0x50, b'x', b'y', b'z', b'z', b'y'];
        let mut out = vec![1, 2];
        lz4(&packed, &mut out, 2 + 17).unwrap();
        assert_eq!(&out[2..], b"abcabcabcabcxyzzy");
        for length in 0..packed.len() {
            assert!(lz4(&packed[..length], &mut Vec::new(), 17).is_err(), "{length}");
        }
        // A match from before the beginning, and one that would make too much.
        assert!(lz4(&[0x10, b'a', 2, 0], &mut Vec::new(), 17).is_err());
        assert!(lz4(&[0x1f, b'a', 1, 0, 200], &mut Vec::new(), 17).is_err());
    }
}
