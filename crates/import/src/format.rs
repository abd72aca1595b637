use std::fmt;

/// A format that can be imported.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Format {
    /// A network capture of a Velodyne sensor, libpcap or pcapng.
    Pcap,
    /// Raw files of the North Campus Long-Term data set: a folder of files, or one file.
    Nclt,
    /// A log of CARMEN, the Carnegie Mellon Robot Navigation Toolkit.
    Carmen,
    /// A bag of ROS 1.
    Bag,
    /// A bag of ROS 2 with SQLite storage: its folder, or its files.
    Bag2,
}

impl Format {
    /// A short name for metadata and options.
    pub fn name(self) -> &'static str {
        match self {
            Self::Pcap => "pcap",
            Self::Nclt => "nclt",
            Self::Carmen => "carmen",
            Self::Bag => "bag",
            Self::Bag2 => "bag2",
        }
    }
}

impl fmt::Display for Format {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Pcap => "a network capture",
            Self::Nclt => "NCLT data",
            Self::Carmen => "a CARMEN log",
            Self::Bag => "a ROS 1 bag",
            Self::Bag2 => "a ROS 2 bag",
        })
    }
}
