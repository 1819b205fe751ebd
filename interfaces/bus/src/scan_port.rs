//! Ports for scans: ordinary and large ones travel on topics of their own, and readers see them as one stream.

use crate::{BusError, LargeScanHeader, SlicePublisher, SliceSample, SliceSubscriber};
use flockslam_messages::{LARGE_SCAN_BEAMS, ScanHeader, ScanProblem, ScanView};

/// Sends scans of any size: large ones on a topic of their own.
pub struct ScanPublisher {
    pub(crate) ordinary: SlicePublisher<ScanHeader>,
    pub(crate) large: SlicePublisher<LargeScanHeader>,
}

impl ScanPublisher {
    /// Writes the scan once into shared memory and sends it.
    ///
    /// # Errors
    /// When no memory is free or a connection is broken.
    pub fn send(&self, scan: ScanView<'_>) -> Result<(), BusError> {
        let numbers = scan.numbers();
        let copy = |slot: &mut [f32]| slot.copy_from_slice(numbers);
        if scan.len() > LARGE_SCAN_BEAMS {
            self.large.send_with(&LargeScanHeader(*scan.header()), numbers.len(), copy)
        } else {
            self.ordinary.send_with(scan.header(), numbers.len(), copy)
        }
    }

    /// Connects to readers that came since the last scan.
    pub fn refresh(&self) {
        self.ordinary.refresh();
        self.large.refresh();
    }
}

/// Receives scans of any size.
pub struct ScanSubscriber {
    pub(crate) ordinary: SliceSubscriber<ScanHeader>,
    pub(crate) large: SliceSubscriber<LargeScanHeader>,
}

impl ScanSubscriber {
    /// The next scan, if one waits. Between the two topics order is by arrival, not by sequence.
    ///
    /// # Errors
    /// When more scans are held than the topic allows, or a connection is broken.
    pub fn receive(&self) -> Result<Option<ScanSample>, BusError> {
        if let Some(sample) = self.ordinary.receive()? {
            return Ok(Some(ScanSample::Ordinary(sample)));
        }
        Ok(self.large.receive()?.map(ScanSample::Large))
    }
}

/// A scan held in the publisher's memory.
pub enum ScanSample {
    /// From the topic of ordinary scans.
    Ordinary(SliceSample<ScanHeader>),
    /// From the topic of large scans.
    Large(SliceSample<LargeScanHeader>),
}

impl ScanSample {
    /// The header.
    pub fn header(&self) -> &ScanHeader {
        match self {
            Self::Ordinary(sample) => sample.header(),
            Self::Large(sample) => &sample.header().0,
        }
    }

    /// The scan, read in place.
    ///
    /// # Errors
    /// When header and numbers do not fit together.
    pub fn view(&self) -> Result<ScanView<'_>, ScanProblem> {
        let numbers = match self {
            Self::Ordinary(sample) => sample.elements(),
            Self::Large(sample) => sample.elements(),
        };
        ScanView::new(self.header(), numbers)
    }
}
