//! One message of each kind and one small frame, whose bytes stand in `golden.rs` and in the document.

#![allow(dead_code, reason = "no test file uses all of it")]

use glam::{DQuat, DVec3, Vec3};
use warplight_protocol::codec::{FrameShape, PlaneKind, StripEncoder};
use warplight_protocol::frame::{
    DepthCoding, FrameFormat, FrameId, Interfaces, Plan, Tree, UNDEFINED, VolumeFormat, VolumeRange, VolumeSegment,
};
use warplight_protocol::message::{
    Capabilities, ErrorCode, FrameAck, FrameBegin, FrameEnd, FramePurpose, Hello, Limiter, LimiterKind, Message,
    PictureMessage, PoseSample, Prediction, Statistics, StillRequest, StripMessage, Viewport, Welcome,
};
use warplight_protocol::optics::Interface;
use warplight_protocol::video::{Canvas, PictureHead, Placement};
use warplight_protocol::wire::write_message;
use warplight_protocol::{Camera, FieldOfView, ImageSize, Pose, Timestamp, Token};

/// A pose that survives the wire: what reading it once gave.
pub(crate) fn pose() -> Pose {
    let pose = Pose { position: DVec3::new(1.5, -2.0, 0.25), orientation: DQuat::from_xyzw(0.0, 0.6, 0.0, 0.8) };
    Pose::from_wire(&pose.to_wire().unwrap()).unwrap()
}

fn at(micros: u64) -> Timestamp {
    Timestamp { micros }
}

/// 4 x 3 pixels of {D, R} in strips of two rows.
pub(crate) fn shape() -> FrameShape {
    FrameShape {
        camera: Camera::perspective(
            ImageSize::new(4, 3),
            FieldOfView { left: -1.0, right: 1.0, down: -0.75, up: 0.75 },
        ),
        plan: Plan::mirror(),
        interfaces: Interfaces(vec![
            Interface::Mirror,
            Interface::Dielectric { eta: 1.5 },
            Interface::Pane { eta: 1.5 },
        ]),
        format: FrameFormat { volume: VolumeFormat { layers: 1, ..VolumeFormat::NONE }, ..FrameFormat::exact() },
        volume: VolumeRange { near_m: 0.5, far_m: 2.0 },
        strip_rows: 2,
        exposure: 0.5,
    }
}

/// A wall at 2 m, right half a mirror that shows the sky in its first row and a wall at 5 m below.
pub(crate) fn tree() -> Tree {
    let shape = shape();
    let mut tree = Tree::new(pose(), shape.camera, shape.plan.clone(), shape.interfaces.clone());
    for pixel in 0..12 {
        let (x, y) = (pixel % 4, pixel / 4);
        let ray = shape.camera.ray_in_view(shape.camera.size.pixel_centre(pixel)).length();
        let root = &mut tree.nodes[0];
        root.distance[pixel] = 2.0 * ray;
        root.set_radiance(pixel, Vec3::new(0.25, 0.5, 1.0) * (1 + x) as f32);
        root.set_normal(pixel, Vec3::Z);
        if x >= 2 {
            root.interface[pixel] = 1;
            tree.nodes[1].distance[pixel] = if y == 0 { f32::INFINITY } else { 5.0 * ray };
            tree.nodes[1].set_radiance(pixel, Vec3::new(0.1, 0.2, 0.05));
        } else {
            tree.nodes[1].distance[pixel] = UNDEFINED;
        }
    }
    // Fog before the left half.
    tree.set_layers(1);
    let fog = VolumeSegment { front_m: 0.5, back_m: 1.5, optical_depth: 0.25, source: Vec3::new(0.5, 0.5, 0.25) };
    let layer = &mut tree.bands_mut(3)[0].layers[0];
    for pixel in 0..12 {
        layer.set(pixel, (pixel % 4 < 2).then_some(&fog));
    }
    tree
}

/// The strips of the frame.
pub(crate) fn strips() -> Vec<Vec<u8>> {
    let (shape, mut tree) = (shape(), tree());
    let mut encoder = StripEncoder::default();
    let one = |rows: &_| {
        let mut strip = Vec::new();
        encoder.encode(&shape, rows, &mut strip);
        strip
    };
    tree.bands_mut(2).iter().map(one).collect()
}

/// One message of each kind.
pub(crate) fn messages() -> Vec<Message> {
    let camera = shape().camera;
    vec![
        Message::Hello(Hello {
            capabilities: Capabilities::ALL,
            software: "client".to_owned(),
            camera,
            viewport: Viewport::Plane,
            frame_hz: 30.0,
            target_kbps: 0,
            prediction: Prediction::Damped,
            token: Token::new("sixteen-and-more").unwrap(),
            adapt: true,
            format: FrameFormat { child_depth: DepthCoding::Relative, ..FrameFormat::exact() },
        }),
        Message::Welcome(Welcome {
            capabilities: Capabilities::RAY_TREE,
            software: "server".to_owned(),
            scene: "gallery".to_owned(),
            effects: vec!["reflection".to_owned()],
            head: Pose { position: DVec3::new(0.0, 1.5, 2.0), orientation: DQuat::IDENTITY },
            exposure: 0.5,
        }),
        Message::Poses(vec![PoseSample { time: at(1_000_000), pose: pose() }]),
        Message::FrameBegin(FrameBegin {
            id: FrameId(7),
            purpose: FramePurpose::Still(3),
            pose_time: at(1_000_000),
            horizon_micros: 25_000,
            scene_time: at(1_040_000),
            render_pose: pose(),
            shape: shape(),
        }),
        Message::Strip(StripMessage { frame: FrameId(7), bytes: strips().remove(1) }),
        Message::FrameEnd(FrameEnd {
            id: FrameId(7),
            pose_received: at(1),
            render_start: at(2),
            render_end: at(3),
            encoded: at(4),
            sent: at(5),
            spp: 16,
        }),
        Message::FrameAck(FrameAck {
            id: FrameId(7),
            pose_to_ready_micros: 40_000,
            receive_micros: 9_000,
            decode_micros: 4_000,
        }),
        Message::Statistics(Statistics {
            frames_rendered: 10,
            frames_sent: 9,
            frames_replaced: 1,
            poses_ignored: 0,
            live_micros: 1_000_000,
            limiters: vec![Limiter {
                kind: LimiterKind::DecodeTime,
                is_active: true,
                active_micros: 250_000,
                why: "slow".to_owned(),
            }],
            counters: vec![("rays.primary".to_owned(), 123)],
        }),
        Message::StillRequest(StillRequest {
            number: 3,
            pose: pose(),
            scene_time: at(2_000_000),
            spp: 256,
            camera,
            with_nodes: true,
        }),
        Message::Ping(at(0x0102_0304)),
        Message::Pong(at(0x0102_0304)),
        Message::Error { code: ErrorCode::Limit, text: "too much".to_owned() },
        Message::Bye,
        Message::Picture(PictureMessage {
            head: PictureHead {
                frame: FrameId(7),
                node: 1,
                kind: PlaneKind::Radiance,
                reference: Some(FrameId(6)),
                placement: Placement { canvas: Canvas { width: 128, height: 64 }, x: 16, y: 32 },
                white: 2.0,
            },
            bytes: vec![0x61, 0xe0, 0x20],
        }),
    ]
}

/// The bytes of a message with its framing.
pub(crate) fn framed(message: &Message) -> Vec<u8> {
    let mut bytes = Vec::new();
    write_message(message, &mut bytes);
    bytes
}

/// Hexadecimal digits.
pub(crate) fn hex(bytes: &[u8]) -> String {
    bytes.iter().map(|byte| format!("{byte:02x}")).collect()
}
