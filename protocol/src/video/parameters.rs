//! The parameter sets of a stream, written from the size of its canvas.
//!
//! H.264 (ITU-T H.264, 7.3.2.1 and 7.3.2.2) has them in the stream. Here both ends write them: the encoder holds what
//! OpenH264 wrote against these and takes them off, the decoder puts them before a key picture. There is one set: high
//! profile at level 5.2, CABAC, one reference, pictures in the order in which they are shown, no cropping.

use super::Canvas;

/// Marks the beginning of a unit in a stream (Annex B).
pub(super) const START_CODE: [u8; 4] = [0, 0, 0, 1];
/// First byte of a unit of a key picture: a reference of the highest priority, type 5.
pub(super) const KEY_SLICE: u8 = 0x65;
/// First byte of a unit of any other picture: a reference, type 1.
pub(super) const SLICE_TYPE: u8 = 1;

/// Frames between two wraps of the frame number, as a power of two.
const LOG2_FRAME_NUMBERS: u32 = 15;

/// The sequence parameter set (type 7), without its start code.
pub(super) fn sequence(canvas: Canvas) -> Vec<u8> {
    let mut bits = BitWriter::new(0x67);
    bits.put(8, 100); // profile_idc: high
    bits.put(8, 0b0000_1100); // constraint_set4_flag: no fields; constraint_set5_flag: no B slices
    bits.put(8, 52); // level_idc
    bits.exp_golomb(0); // seq_parameter_set_id
    bits.exp_golomb(1); // chroma_format_idc: 4:2:0
    bits.exp_golomb(0); // bit_depth_luma_minus8
    bits.exp_golomb(0); // bit_depth_chroma_minus8
    bits.put(2, 0); // qpprime_y_zero_transform_bypass_flag, seq_scaling_matrix_present_flag
    bits.exp_golomb(LOG2_FRAME_NUMBERS - 4);
    bits.exp_golomb(2); // pic_order_cnt_type: shown as decoded
    bits.exp_golomb(1); // max_num_ref_frames
    bits.put(1, 0); // gaps_in_frame_num_value_allowed_flag
    bits.exp_golomb(u32::from(canvas.width) / 16 - 1);
    bits.exp_golomb(u32::from(canvas.height) / 16 - 1);
    bits.put(1, 1); // frame_mbs_only_flag
    bits.put(1, 1); // direct_8x8_inference_flag
    bits.put(1, 0); // frame_cropping_flag
    bits.put(1, 1); // vui_parameters_present_flag
    bits.put(8, 0); // no aspect ratio, overscan, signal type, chroma place, timing, two kinds of HRD, structure
    bits.put(1, 1); // bitstream_restriction_flag
    bits.put(1, 1); // motion_vectors_over_pic_boundaries_flag
    bits.exp_golomb(0); // max_bytes_per_pic_denom
    bits.exp_golomb(0); // max_bits_per_mb_denom
    bits.exp_golomb(16); // log2_max_mv_length_horizontal
    bits.exp_golomb(16); // log2_max_mv_length_vertical
    bits.exp_golomb(0); // max_num_reorder_frames
    bits.exp_golomb(1); // max_dec_frame_buffering
    bits.finish()
}

/// The picture parameter set (type 8), without its start code.
pub(super) fn picture() -> Vec<u8> {
    let mut bits = BitWriter::new(0x68);
    bits.exp_golomb(0); // pic_parameter_set_id
    bits.exp_golomb(0); // seq_parameter_set_id
    bits.put(1, 1); // entropy_coding_mode_flag: CABAC
    bits.put(1, 0); // bottom_field_pic_order_in_frame_present_flag
    bits.exp_golomb(0); // num_slice_groups_minus1
    bits.exp_golomb(0); // num_ref_idx_l0_default_active_minus1
    bits.exp_golomb(0); // num_ref_idx_l1_default_active_minus1
    bits.put(3, 0); // weighted_pred_flag, weighted_bipred_idc
    bits.exp_golomb(0); // pic_init_qp_minus26
    bits.exp_golomb(0); // pic_init_qs_minus26
    bits.exp_golomb(0); // chroma_qp_index_offset
    bits.put(1, 1); // deblocking_filter_control_present_flag
    bits.put(2, 0); // constrained_intra_pred_flag, redundant_pic_cnt_present_flag
    bits.finish()
}

/// Bits of a unit, the highest first.
struct BitWriter {
    bytes: Vec<u8>,
    held: u8,
    count: u32,
}

impl BitWriter {
    fn new(header: u8) -> BitWriter {
        BitWriter { bytes: vec![header], held: 0, count: 0 }
    }

    fn put(&mut self, count: u32, value: u32) {
        for bit in (0..count).rev() {
            self.held = self.held << 1 | (value >> bit & 1) as u8;
            self.count += 1;
            if self.count == 8 {
                self.byte();
            }
        }
    }

    /// A whole byte; the third of three that could be taken for a start code is announced by a 3 (7.4.1).
    fn byte(&mut self) {
        if self.held <= 3 && self.bytes.ends_with(&[0, 0]) {
            self.bytes.push(3);
        }
        self.bytes.push(self.held);
        (self.held, self.count) = (0, 0);
    }

    /// ue(v) (9.1): as many zeros as the number behind them has bits after its first.
    fn exp_golomb(&mut self, value: u32) {
        let zeros = (value + 1).ilog2();
        self.put(zeros, 0);
        self.put(zeros + 1, value + 1);
    }

    /// A one, and zeros to the end of the byte.
    fn finish(mut self) -> Vec<u8> {
        self.put(1, 1);
        while self.count > 0 {
            self.put(1, 0);
        }
        self.bytes
    }
}
