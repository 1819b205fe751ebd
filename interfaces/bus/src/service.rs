//! The kind of iceoryx2 service that everything here is.

use iceoryx2::prelude::ipc;

/// The iceoryx2 service type of the whole product: shared memory between processes, single-threaded ports.
pub type Service = ipc::Service;
