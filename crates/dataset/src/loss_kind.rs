//! The kinds of [losses](crate::Losses), with code, severity and sentence.

use serde::{Deserialize, Serialize};

use crate::codes::codes;

codes! {
    /// The kinds of data that are left out. `docs/messages.md` gives meaning, usual cause and
    /// remedy of each.
    #[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
    pub enum LossKind (s) {
        // The MCAP file.

        /// The file ends without a footer.
        Warning "truncated_file" TruncatedFile
            => "file{s} cut off at the end (no footer: the recorder stopped early or the copy is incomplete)";
        /// The summary section is damaged.
        Warning "damaged_summary" DamagedSummary
            => "damaged summary section{s} (the file was read without its index)";
        /// The index of a chunk contradicts the data.
        Warning "contradictory_index" ContradictoryIndex
            => "chunk{s} with an index entry that contradicts the data (the file was read without its index)";
        /// Bytes between two chunks are not records.
        Warning "bytes_between_chunks" BytesBetweenChunks
            => "byte range{s} between chunks without records";
        /// Another file follows the footer.
        Warning "bytes_after_end" BytesAfterEnd
            => "byte{s} after the footer of the file, not read (if files were joined byte by byte, join them with `mcap merge` instead)";
        /// A record has an opcode that the format does not define.
        Warning "unknown_records" UnknownRecords
            => "record{s} of a kind that the MCAP format does not define";
        /// A record does not parse.
        Warning "malformed_records" MalformedRecords => "malformed record{s}";
        /// A record that must not be inside a chunk.
        Warning "misplaced_records" MisplacedRecords
            => "record{s} of a kind that must not be in a chunk";
        /// The header of a chunk does not parse.
        Warning "malformed_chunks" MalformedChunks => "chunk{s} with a malformed header";
        /// A chunk claims an impossible size.
        Warning "oversized_chunks" OversizedChunks {
            /// The largest size that is accepted.
            max_bytes: u64,
        } => "chunk{s} with a claimed size of more than {max_bytes} bytes";
        /// A chunk claims more bytes than the memory of the machine.
        Warning "chunks_beyond_memory" ChunksBeyondMemory
            => "chunk{s} with a claimed size that exceeds the memory of this machine";
        /// A chunk of unknown compression.
        Warning "chunks_of_unknown_compression" ChunksOfUnknownCompression {
            /// The name in the header.
            compression: String,
        } => "chunk{s} with unknown compression `{compression}`";
        /// The decompressed length differs from the header's.
        Warning "chunk_length_mismatch" ChunkLengthMismatch
            => "chunk{s} with a length that contradicts the header";
        /// The CRC of a chunk does not match.
        Warning "chunk_crc_mismatch" ChunkCrcMismatch
            => "chunk{s} with a wrong CRC (bytes were altered)";
        /// A chunk does not decompress.
        Warning "undecompressable_chunks" UndecompressableChunks => "chunk{s} with damaged compressed data";
        /// A chunk ends within a record.
        Warning "truncated_chunks" TruncatedChunks => "chunk{s} ending within a record";
        /// A message belongs to a channel that the file does not define.
        Warning "undefined_channel" UndefinedChannel
            => "message{s} of a channel that the file does not define";
        /// A channel has two definitions that contradict each other.
        Warning "redefined_channels" RedefinedChannels {
            /// The topic of the second definition.
            second: String,
        } => "channel{s} defined twice with different topics or types (the second time as `{second}`)";
        /// The statistics of the file count more messages than it contains.
        Warning "missing_messages" MissingMessages
            => "message{s} counted in the statistics of the file but not in its data";
        /// A file of a split drive that `metadata.yaml` lists is missing.
        Warning "missing_drive_file" MissingDriveFile
            => "file{s} listed in metadata.yaml but missing (if it is compressed, decompress it)";
        /// A file of a split drive cannot be read.
        Warning "unreadable_drive_file" UnreadableDriveFile => "file{s} of a split drive that cannot be read";
        /// A log cannot be ingested.
        Warning "log_left_out" LogLeftOut {
            /// The code of the error.
            error: String,
        } => "log{s} left out of the run ({error})";
        /// A log has the same bytes as another.
        Warning "duplicate_log" DuplicateLog {
            /// The log that is used.
            used: String,
        } => "log{s} with the same bytes as log `{used}` (equal BLAKE3 digests): only `{used}` is used";

        // Messages.

        /// A message does not decode as its type.
        Warning "undecodable_messages" UndecodableMessages {
            /// The type, by name.
            message_type: String,
            /// What is wrong, by code.
            fault: String,
        } => "message{s} that could not be decoded as {message_type} ({fault})";
        /// A message was compressed by the recorder.
        Warning "compressed_messages" CompressedMessages {
            /// The type, by name.
            message_type: String,
        } => "{message_type} message{s} that the recorder compressed one by one with Zstandard (rosbag2, `--compression-mode message`): convert the bag with `ros2 bag convert`, with no compression or with chunk compression (`storage_preset_profile: zstd_fast`)";
        /// A point cloud lacks a field.
        Warning "clouds_without_field" CloudsWithoutField {
            /// The missing field.
            field: String,
            /// The fields of the cloud.
            fields: String,
        } => "point cloud{s} without a field `{field}` (fields: {fields})";
        /// A channel of the topic has another type.
        Warning "messages_of_other_type" MessagesOfOtherType {
            /// Schema and encoding.
            found: String,
        } => "message{s} of another type ({found})";
        /// A value is NaN or infinite.
        Warning "non_finite_messages" NonFiniteMessages => "message{s} with NaN or infinite values";
        /// A message has the stamp 0.
        Warning "unstamped_messages" UnstampedMessages
            => "message{s} with the stamp 0 (set `ingest.lidar.stamp` or `ingest.pose.stamp` to \"log\" to use log times)";
        /// A coordinate is finite but impossible.
        Warning "impossible_positions" ImpossiblePositions {
            /// Largest possible coordinate \[m\].
            max_m: u64,
        } => "message{s} with a position farther than {max_m} m from the origin";
        /// A reading of a wheel or an IMU is finite but impossible.
        Warning "impossible_readings" ImpossibleReadings {
            /// Largest possible value.
            max: u64,
        } => "message{s} with a speed, turn rate, acceleration or wheel position of more than {max}";
        /// A pose jumps away from the poses before and after it.
        Warning "pose_outliers" PoseOutliers
            => "outlier{s} among the poses, far away from the poses before and after; not used";
        /// Poses at times that occur twice.
        Warning "poses_at_repeated_times" PosesAtRepeatedTimes
            => "pose{s} at times that occur twice, because the clock was set back; not used";
        /// A transform has no rotation.
        Warning "transform_without_rotation" TransformWithoutRotation {
            /// The first quaternion, x, y, z, w.
            quaternion: String,
        } => "transform{s} whose quaternion (x, y, z, w) is not of length 1: ({quaternion})";
        /// A quaternion is not of length 1.
        Warning "quaternion_not_normalized" QuaternionNotNormalized
            => "message{s} with a quaternion that is not of length 1";
        /// A satellite message has no fix.
        Warning "no_gnss_fix" NoGnssFix => "message{s} without a satellite fix (status below 0)";
        /// A fix at latitude and longitude 0.
        Warning "gnss_fix_at_zero" GnssFixAtZero
            => "satellite position{s} at latitude 0, longitude 0 (receivers send it without a fix)";
        /// A latitude, longitude or altitude out of range.
        Warning "gnss_fix_out_of_range" GnssFixOutOfRange
            => "satellite position{s} with a latitude, longitude or altitude out of range";
        /// A JointState message has no wheels.
        Warning "no_wheel_joints" NoWheelJoints {
            /// The joints of the message.
            joints: String,
        } => "message{s} without driven wheels on the left and on the right (joints: {joints})";
        /// A JointState message has more wheels on one side.
        Warning "unequal_wheel_joints" UnequalWheelJoints {
            /// Wheels on the left.
            n_left: u64,
            /// Wheels on the right.
            n_right: u64,
            /// The joints of the message.
            joints: String,
        } => "message{s} with {n_left} wheels on the left and {n_right} on the right, expected the same number; name them in `ingest.pose.wheels` (joints: {joints})";
        /// A step of a wheel position that no wheel can make.
        Warning "wheel_position_jumps" WheelPositionJumps
            => "step{s} of the wheel positions left out: no wheel turns that fast, or the size of a step after a pause is not known (the counter was reset or wrapped)";

        // Velodyne packets.

        /// A packet appears in two files of a split drive.
        Warning "packets_in_two_files" PacketsInTwoFiles
            => "packet{s} contained in two files of the drive";
        /// A packet without a stamp.
        Warning "unstamped_packets" UnstampedPackets => "packet{s} with the stamp 0 (set `ingest.lidar.stamp` to \"log\" to use log times, or `ingest.lidar.clock` to \"device\")";
        /// A packet appears twice.
        Warning "duplicate_packets" DuplicatePackets => "duplicate packet{s}";
        /// A packet arrives after its revolution was finished.
        Warning "late_packets" LatePackets => "packet{s} too late to be put back in order";
        /// The device clock was set back over other packets.
        Warning "packets_at_taken_time" PacketsAtTakenTime
            => "packet{s} at a time that another packet has (device clock set back)";
        /// Bytes that are not an HDL-32E data packet.
        Warning "malformed_packets" MalformedPackets
            => "packet{s} without the layout of an HDL-32E data packet";
        /// Packets of another Velodyne.
        Warning "packets_of_other_model" PacketsOfOtherModel {
            /// The model, by name.
            model: String,
        } => "packet{s} of a Velodyne {model}";
        /// The device clock does not run on GPS time.
        Warning "packets_off_gps_time" PacketsOffGpsTime
            => "packet{s} whose device clock is not on GPS time (more than 60 s from the stamps; set `ingest.lidar.clock` to \"host\" or \"device\")";
        /// The packet stream is interrupted.
        Warning "packet_stream_interruptions" PacketStreamInterruptions
            => "interruption{s} of the packet stream (clock jump or pause)";
        /// A revolution takes too long.
        Warning "stalled_revolutions" StalledRevolutions
            => "revolution{s} of more than 0.46 s (the sensor stalled)";
        /// A revolution without a single packet.
        Warning "missing_revolutions" MissingRevolutions
            => "revolution{s} with all packets missing";
        /// A revolution with too many missing packets.
        Warning "incomplete_revolutions" IncompleteRevolutions {
            /// The limit \[%\].
            max_missing_percent: String,
        } => "revolution{s} with more than {max_missing_percent} % of the packets missing";

        // Scans, poses, transforms.

        /// The angles of a planar scan contradict each other.
        Warning "contradictory_angles" ContradictoryAngles {
            /// The first contradiction.
            example: String,
        } => "planar scan{s} with contradictory angles ({example})";
        /// A scan appears twice.
        Warning "duplicate_scans" DuplicateScans => "duplicate scan{s}";
        /// A cloud has more than one revolution.
        Warning "returns_beyond_revolution" ReturnsBeyondRevolution
            => "return{s} after the first revolution of the cloud";
        /// A pose has the stamp of another pose.
        Warning "duplicate_pose_stamps" DuplicatePoseStamps
            => "pose{s} with the stamp of another pose";
        /// A transform of the chain is not known at the stamp of a pose.
        Warning "poses_without_transform" PosesWithoutTransform
            => "pose{s} at a time when another transform of the chain is not known";
        /// A stamp repeats in the wheel or IMU samples.
        Warning "duplicate_sample_stamps" DuplicateSampleStamps {
            /// `wheel` or `imu`.
            sensor: String,
        } => "{sensor} sample{s} with a repeated stamp";
        /// A stamp steps back in the wheel or IMU samples.
        Warning "sample_stamps_step_back" SampleStampsStepBack {
            /// `wheel` or `imu`.
            sensor: String,
        } => "{sensor} sample{s} whose stamp steps back";
        /// A sample is NaN or infinite.
        Warning "non_finite_samples" NonFiniteSamples {
            /// `wheel` or `imu`.
            sensor: String,
        } => "{sensor} sample{s} with NaN or infinite values";
        /// A pose is requested before the first wheel sample.
        Warning "stamps_before_wheels" StampsBeforeWheels
            => "requested stamp{s} before the first wheel sample";
        /// A pose is requested after the last wheel sample.
        Warning "stamps_after_wheels" StampsAfterWheels
            => "requested stamp{s} after the last wheel sample";
        /// A pose is requested twice for the same stamp.
        Warning "duplicate_requested_stamps" DuplicateRequestedStamps
            => "stamp{s} requested twice";

        // Keyframes.

        /// A scan before the first pose.
        Warning "scans_before_poses" ScansBeforePoses => "scan{s} before the first pose";
        /// A scan after the last pose.
        Warning "scans_after_poses" ScansAfterPoses => "scan{s} after the last pose";
        /// A scan in a gap between poses.
        Warning "scans_in_pose_gap" ScansInPoseGap => "scan{s} in a gap between poses";
        /// A scan between two segments of the trajectory.
        Warning "scans_between_segments" ScansBetweenSegments
            => "scan{s} between two segments of the trajectory (the poses jump or the clock steps there)";
        /// A scan from which no features can be computed.
        Warning "unusable_scans" UnusableScans
            => "scan{s} with fewer than 3 returns or all returns on one line";
        /// A scan covers less than a full circle, unlike most scans of its log.
        Info "partial_scans" PartialScans
            => "scan{s} with less than a full circle, in a log of full circles, not used as keyframes";

        // Import: rows and lines.

        /// A time that a log cannot have.
        Warning "times_out_of_range" TimesOutOfRange {
            /// What has the time: `row`, `line`, `packet`.
            item: String,
        } => "{item}{s} with a time before 1970 or after 2037";
        /// A row of a table does not parse.
        Warning "malformed_rows" MalformedRows {
            /// The columns that were expected.
            columns: String,
        } => "malformed row{s} (expected {columns})";
        /// A row has a value that is not a number.
        Warning "rows_with_nan" RowsWithNan => "row{s} with NaN or infinite values";
        /// The last row has no line break.
        Info "row_without_line_end" RowWithoutLineEnd => "last row{s} without a line break";
        /// A row of a satellite receiver has no fix.
        Info "rows_without_fix" RowsWithoutFix => "row{s} without a satellite fix";
        /// A row has no recent earlier row, and no rate can be computed.
        Info "rows_without_predecessor" RowsWithoutPredecessor
            => "row{s} without a recent earlier row (needed to compute a rate)";
        /// A file is not needed, because another one contains the same data.
        Info "superseded_file" SupersededFile {
            /// The file used instead.
            used: String,
        } => "file{s} not needed ({used} is used)";
        /// A file cannot be used without another one.
        Warning "file_without_partner" FileWithoutPartner {
            /// The file it belongs to.
            partner: String,
        } => "file{s} not used ({partner} is missing)";
        /// A binary file ends within a packet.
        Warning "truncated_hits" TruncatedHits
            => "file{s} cut off within a packet (complete packets are kept)";
        /// Bytes that are not packets.
        Warning "bytes_between_packets" BytesBetweenPackets
            => "damaged section{s} between packets (skipped)";
        /// A hit of a laser that an HDL-32E does not have.
        Warning "hits_of_unknown_laser" HitsOfUnknownLaser => "hit{s} of a laser above 31";
        /// Rings could not be ordered by elevation.
        Info "rings_by_file_number" RingsByFileNumber
            => "revolution{s} with laser numbers as ring numbers (the elevations match no order of an HDL-32E)";
        /// A message is earlier than the previous one.
        Info "message_times_step_back" MessageTimesStepBack
            => "message{s} earlier than the previous message (the log time is that of the previous message)";
        /// A line of a kind that has no sensor data.
        Info "lines_without_sensor_data" LinesWithoutSensorData {
            /// The first word of the line.
            keyword: String,
        } => "{keyword} line{s} not imported (no sensor data)";
        /// A line of a kind that is not imported.
        Info "lines_not_imported" LinesNotImported {
            /// The first word of the line.
            keyword: String,
        } => "{keyword} line{s} not imported (unsupported message)";
        /// A line with the same scan as another line.
        Info "repeated_scan_lines" RepeatedScanLines {
            /// The first word of the line.
            keyword: String,
        } => "{keyword} line{s} not imported (other lines have the same scans, with poses)";
        /// The times of one kind of line cannot be used.
        Warning "lines_without_time" LinesWithoutTime {
            /// What the lines contain: `ODOM`, `rear scan`, ...
            item: String,
            /// What is wrong with the times.
            fault: String,
        } => "{item} line{s} not imported, because their times cannot be used ({fault})";
        /// A line that does not parse.
        Warning "malformed_lines" MalformedLines {
            /// The first word of the line.
            keyword: String,
        } => "malformed {keyword} line{s}";

        // Import: bags.

        /// The end of a bag is missing.
        Warning "truncated_bag" TruncatedBag
            => "bag{s} without an end: not closed, or cut off (complete messages are kept)";
        /// A bag is damaged.
        Warning "damaged_bag" DamagedBag {
            /// Where the damage starts.
            at_byte: u64,
        } => "bag{s} damaged at byte {at_byte} (earlier messages are kept)";
        /// A chunk of a bag is damaged.
        Warning "damaged_bag_chunks" DamagedBagChunks
            => "chunk{s} of a bag that cannot be unpacked (the other chunks are kept)";
        /// A message of a bag cannot be read.
        Warning "damaged_messages" DamagedMessages => "message{s} that cannot be read or unpacked";
        /// The messages of a database cannot all be listed.
        Warning "damaged_database" DamagedDatabase
            => "damaged database{s} of a bag (the messages before the damage are kept)";
        /// A message of a topic that the bag does not describe.
        Warning "messages_without_connection" MessagesWithoutConnection
            => "message{s} of a topic that the bag does not describe";
        /// A bag has no definition of a message type.
        Info "types_without_definition" TypesWithoutDefinition {
            /// The message type.
            message_type: String,
        } => "topic{s} of type {message_type}, which the bag does not define";

        // Import: captures.

        /// A packet of an interface that the capture does not describe.
        Warning "packets_of_unknown_interface" PacketsOfUnknownInterface
            => "captured packet{s} of an interface that the capture does not describe";
        /// A packet without a time.
        Warning "packets_without_time" PacketsWithoutTime
            => "captured packet{s} without a time (simple packet blocks)";
        /// A capture ends within a packet.
        Warning "truncated_capture" TruncatedCapture
            => "capture{s} cut off within a packet (complete packets are kept)";
        /// A capture is damaged.
        Warning "damaged_capture" DamagedCapture {
            /// Where the damage starts.
            at_byte: u64,
        } => "capture{s} damaged at byte {at_byte} (earlier packets are kept)";
        /// A datagram to another port.
        Info "datagrams_to_other_ports" DatagramsToOtherPorts {
            /// The ports and their numbers of datagrams.
            ports: String,
        } => "UDP datagram{s} to other ports ({ports})";
        /// A data packet to another port, in a capture without data packets on the data port.
        Warning "data_packets_to_other_port" DataPacketsToOtherPort {
            /// The port of the packets.
            port: u16,
            /// The data port of the import.
            used: u16,
        } => "Velodyne data packet{s} to port {port}, expected port {used}: set `--udp-port {port}`";
        /// A datagram of another size to the position port.
        Info "datagrams_not_positions" DatagramsNotPositions
            => "datagram{s} to the position port with a length other than 512 bytes";
        /// A datagram to the data port that is not a data packet.
        Warning "datagrams_not_data" DatagramsNotData
            => "datagram{s} to the data port without the layout of a Velodyne data packet (1206 bytes, starting with 0xeeff)";
        /// A packet of a sensor that was not selected.
        Info "packets_of_other_sensors" PacketsOfOtherSensors => "packet{s} of other sensors";
        /// A position packet without a fix.
        Info "positions_without_fix" PositionsWithoutFix => "position packet{s} without a fix";
        /// A position packet whose sentence is damaged.
        Warning "damaged_positions" DamagedPositions
            => "position packet{s} with a damaged NMEA sentence";
        /// A frame cut short by the snapshot length.
        Warning "truncated_frames" TruncatedFrames
            => "frame{s} truncated by the snapshot length of the capture";
        /// A frame that is not UDP.
        Info "frames_not_udp" FramesNotUdp {
            /// The protocol of the frame.
            protocol: String,
        } => "frame{s} of another protocol than UDP ({protocol})";
        /// A frame that cannot be decoded.
        Warning "undecodable_frames" UndecodableFrames {
            /// What is wrong.
            fault: String,
        } => "undecodable frame{s} ({fault})";
    }
}
