//! The iceoryx2 services that carry the records: one service of records and one of wake-ups each way.

use super::SharedError;
use iceoryx2::port::listener::Listener;
use iceoryx2::port::notifier::Notifier;
use iceoryx2::port::publisher::Publisher;
use iceoryx2::port::subscriber::Subscriber;
use iceoryx2::prelude::*;
use iceoryx2::service::builder::publish_subscribe::{
    PublishSubscribeOpenError, PublishSubscribeOpenOrCreateError,
};
use iceoryx2::service::port_factory::{event, publish_subscribe};
use rustix::fd::BorrowedFd;
use serde::Serialize;
use serde::de::DeserializeOwned;
use std::time::Duration;

type Service = ipc_threadsafe::Service;

/// Room for a record in postcard; the longest is a driver's with four picks.
pub(super) const RECORD_LEN_MAX: usize = 1532;

/// How long to wait for the remains of a killed process to be cleared away: pauses, ms.
const RETRY_PAUSES_MS: [u64; 6] = [20, 50, 100, 200, 400, 800];

/// A record as it lies in the shared memory. Its name tells apart other payloads and other versions.
#[repr(C)]
#[derive(Clone, Copy, Debug, ZeroCopySend)]
#[type_name("pickcell record 1")]
pub(crate) struct Sample {
    len: u32,
    bytes: [u8; RECORD_LEN_MAX],
}

/// Whose ports these are.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Side {
    /// Publishes [`super::CellRecord`]s.
    Driver,
    /// Publishes [`super::ArmRecord`]s.
    Bridge,
}

/// All ports of one side.
#[derive(Debug)]
pub struct Ports {
    publisher: Publisher<Service, Sample, ()>,
    subscriber: Subscriber<Service, Sample, ()>,
    notifier: Notifier<Service>,
    listener: Listener<Service>,
    // Dropped last: the ports belong to it.
    _node: Node<Service>,
}

impl Ports {
    /// Opens or creates the services of this name.
    ///
    /// # Errors
    /// See [`SharedError`]. What a killed process left behind is waited for, up to about 1.5 s.
    pub fn open(service: &str, side: Side) -> Result<Self, SharedError> {
        // It would write to standard error by itself.
        set_log_level(LogLevel::Fatal);
        let mut pauses = RETRY_PAUSES_MS.iter();
        loop {
            match (Self::try_open(service, side), pauses.next()) {
                (Err(SharedError::InUse { .. } | SharedError::Failed { .. }), Some(&pause_ms)) => {
                    std::thread::sleep(Duration::from_millis(pause_ms));
                }
                (result, _) => return result,
            }
        }
    }

    fn try_open(service: &str, side: Side) -> Result<Self, SharedError> {
        let failed = |detail: String| SharedError::Failed { service: service.into(), detail };
        let node = NodeBuilder::new()
            .signal_handling_mode(SignalHandlingMode::Disabled)
            .create::<Service>()
            .map_err(|error| failed(format!("{error:?}")))?;
        let to_arm = records(&node, service, "to-arm")?;
        let from_arm = records(&node, service, "from-arm")?;
        let wake_arm = wakes(&node, service, "wake-arm")?;
        let wake_driver = wakes(&node, service, "wake-driver")?;
        let (out, inward, out_wake, in_wake) = match side {
            Side::Driver => (to_arm, from_arm, wake_arm, wake_driver),
            Side::Bridge => (from_arm, to_arm, wake_driver, wake_arm),
        };
        use iceoryx2::port::publisher::PublisherCreateError as P;
        let publisher = out.publisher_builder().create().map_err(|error| match error {
            P::ExceedsMaxSupportedPublishers => {
                let side = if side == Side::Driver { "driver" } else { "bridge" };
                SharedError::InUse { service: service.into(), side }
            }
            other => failed(format!("{other:?}")),
        })?;
        Ok(Self {
            publisher,
            subscriber: inward.subscriber_builder().create().map_err(|error| failed(format!("{error:?}")))?,
            notifier: out_wake.notifier_builder().create().map_err(|error| failed(format!("{error:?}")))?,
            listener: in_wake.listener_builder().create().map_err(|error| failed(format!("{error:?}")))?,
            _node: node,
        })
    }

    /// Publishes a record and wakes the other side. That nobody is there is no error.
    pub fn publish<R: Serialize>(&self, record: &R) {
        let mut sample = Sample { len: 0, bytes: [0; RECORD_LEN_MAX] };
        let len = postcard::to_slice(record, &mut sample.bytes).map_or(0, |bytes| bytes.len());
        assert!(len > 0, "the longest record fits");
        sample.len = len as u32;
        let _ = self.publisher.send_copy(sample);
        let _ = self.notifier.notify();
    }

    /// The newest record of the other side, if there is one that was not read yet. Bytes that are none are skipped.
    pub fn receive<R: DeserializeOwned>(&self) -> Option<R> {
        let _ = self.listener.try_wait(|_| {});
        let mut newest = None;
        while let Ok(Some(sample)) = self.subscriber.receive() {
            newest =
                sample.bytes.get(..sample.len as usize).and_then(|bytes| postcard::from_bytes(bytes).ok());
        }
        newest
    }

    /// Can be read when the other side has published.
    #[allow(unsafe_code)]
    pub fn fd(&self) -> BorrowedFd<'_> {
        // SAFETY: the descriptor belongs to the listener and stays open as long as it; the borrow of `self` keeps the
        // listener alive, and it is only waited for, not closed or read.
        unsafe { BorrowedFd::borrow_raw(self.listener.file_descriptor().native_handle()) }
    }
}

fn name(service: &str, what: &str) -> Result<ServiceName, SharedError> {
    let full = format!("pickcell/{service}/{what}");
    ServiceName::new(&full)
        .map_err(|error| SharedError::Failed { service: service.into(), detail: format!("{error:?}") })
}

fn records(
    node: &Node<Service>,
    service: &str,
    what: &str,
) -> Result<publish_subscribe::PortFactory<Service, Sample, ()>, SharedError> {
    let builder = node.service_builder(&name(service, what)?).publish_subscribe::<Sample>();
    builder
        .subscriber_max_buffer_size(1)
        .enable_safe_overflow(true)
        .history_size(0)
        .max_publishers(1)
        .max_subscribers(1)
        .open_or_create()
        .map_err(|error| {
            use PublishSubscribeOpenError as E;
            let detail = format!("{error:?}");
            match error {
                PublishSubscribeOpenOrCreateError::PublishSubscribeOpenError(
                    E::IncompatibleTypes
                    | E::IncompatibleMessagingPattern
                    | E::IncompatibleAttributes
                    | E::IncompatibleOverflowBehavior
                    | E::DoesNotSupportRequestedMinBufferSize
                    | E::DoesNotSupportRequestedAmountOfPublishers
                    | E::DoesNotSupportRequestedAmountOfSubscribers
                    | E::VersionMismatch,
                ) => SharedError::Taken { service: service.into(), detail },
                _ => SharedError::Failed { service: service.into(), detail },
            }
        })
}

fn wakes(
    node: &Node<Service>,
    service: &str,
    what: &str,
) -> Result<event::PortFactory<Service>, SharedError> {
    let builder = node.service_builder(&name(service, what)?).event();
    builder
        .open_or_create()
        .map_err(|error| SharedError::Failed { service: service.into(), detail: format!("{error:?}") })
}
