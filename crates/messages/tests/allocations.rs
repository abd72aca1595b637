//! A reader does not allocate memory for a wrong length in a message.

use std::alloc::{GlobalAlloc, Layout, System};
use std::cell::Cell;
use std::hint::black_box;

use messages::{
    Encoding, JointState, LaserScan, MessageType, PointCloud, PointField, Scalar, Source,
    Transform, is_plausible_message, ros,
};

struct LargestAllocation;

thread_local! {
    static LARGEST: Cell<usize> = const { Cell::new(0) };
}

// SAFETY: every call is passed to the system allocator unchanged.
unsafe impl GlobalAlloc for LargestAllocation {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        LARGEST.with(|largest| largest.set(largest.get().max(layout.size())));
        // SAFETY: the caller upholds the contract of the system allocator.
        unsafe { System.alloc(layout) }
    }

    unsafe fn dealloc(&self, pointer: *mut u8, layout: Layout) {
        // SAFETY: the caller upholds the contract of the system allocator.
        unsafe { System.dealloc(pointer, layout) }
    }
}

#[global_allocator]
static ALLOCATOR: LargestAllocation = LargestAllocation;

fn messages(encoding: Encoding) -> [(MessageType, Vec<u8>); 5] {
    let packet = messages::hdl32e::PacketBuilder::new([0; 12], 0).finish();
    let cloud = PointCloud {
        stamp_ns: 1,
        width: 3,
        height: 1,
        point_step: 4,
        row_step: 12,
        big_endian: false,
        fields: vec![PointField { name: "x".to_owned(), offset: 0, kind: Scalar::F32 }],
        data: vec![0; 12].into(),
    };
    let laser = LaserScan {
        stamp_ns: 1,
        angle_min: 0.0,
        angle_max: None,
        angle_increment: 0.1,
        time_increment_s: 0.0,
        range_min: 0.0,
        range_max: 9.0,
        ranges: vec![1.0; 5],
    };
    let joints = JointState {
        stamp_ns: 1,
        names: vec!["left".to_owned(), "right".to_owned()],
        positions: vec![1.0; 2],
        velocities: vec![1.0; 2],
    };
    let transform = Transform {
        stamp_ns: 1,
        parent: "map".to_owned(),
        child: "base".to_owned(),
        translation: [0.0; 3],
        rotation: [0.0, 0.0, 0.0, 1.0],
    };
    [
        (MessageType::VelodyneScan, ros::write_velodyne_scan(encoding, "v", 1, &[(1, packet)])),
        (MessageType::PointCloud2, ros::write_point_cloud2(encoding, "v", &cloud)),
        (MessageType::LaserScan, ros::write_laser_scan(encoding, "l", &laser)),
        (MessageType::JointState, ros::write_joint_state(encoding, "", &joints)),
        (MessageType::Tf, ros::write_tf(encoding, &[transform])),
    ]
}

#[test]
fn a_wrong_length_does_not_cause_a_large_allocation() {
    for encoding in [Encoding::Cdr, Encoding::Ros1] {
        for (message_type, bytes) in messages(encoding) {
            let source = Source { message_type, encoding };
            assert!(is_plausible_message(source, &bytes), "{source}");
            for at in 0..bytes.len() - 4 {
                for length in [1 << 16, u32::MAX >> 4, u32::MAX] {
                    let mut bytes = bytes.clone();
                    bytes[at..at + 4].copy_from_slice(&length.to_le_bytes());
                    LARGEST.set(0);
                    black_box(is_plausible_message(source, &bytes));
                    // A name of four bytes becomes a `String` of 24 bytes, and vectors grow by doubling.
                    let limit = 12 * bytes.len() + 1024;
                    assert!(LARGEST.get() <= limit, "{source}, {length} at {at}: {LARGEST:?}");
                }
            }
        }
    }
}
