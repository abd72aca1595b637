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
}

impl Format {
    /// A short name for metadata and options.
    pub fn name(self) -> &'static str {
        match self {
            Self::Pcap => "pcap",
            Self::Nclt => "nclt",
            Self::Carmen => "carmen",
        }
    }
}

impl fmt::Display for Format {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Pcap => "a network capture",
            Self::Nclt => "NCLT data",
            Self::Carmen => "a CARMEN log",
        })
    }
}
