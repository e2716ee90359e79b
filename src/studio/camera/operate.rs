//! What the body does when it is asked, whatever transport brought the question.

use super::body::Body;
use super::datasets::{self, op};
use super::device::{Device, Frame};
use super::dials;
use super::fault::Fault;
use super::objects::Objects;
use super::properties::{SetError, parse_set, prop};
use super::request::{Answer, Outcome, Request, code};
use std::io;
use std::sync::Arc;

/// RemoteRelease's parameter for the second pressure point.
const FULL_PRESS: u32 = 2;

/// Carries a request out; `sent` is the client's data phase.
pub(super) fn operate(request: &Request, sent: &[u8], device: &Arc<Device>) -> io::Result<Outcome> {
    let mut body = device.body()?;
    let [full, low] = {
        let faults = device.faults();
        [Fault::NoRoom, Fault::LowBattery].map(|fault| faults.has(fault))
    };
    body.show(full, low);
    Ok(Outcome::Answer(match request.operation {
        op::GET_DEVICE_INFO => Answer::data(datasets::device_info(&device.serial)),
        op::EOS_GET_DEVICE_INFO => Answer::data(datasets::eos_device_info(&body.properties())),
        op::GET_STORAGE_IDS | op::EOS_GET_STORAGE_IDS => Answer::data(datasets::array(&[datasets::STORAGE])),
        op::GET_STORAGE_INFO | op::EOS_GET_STORAGE_INFO => Answer::data(datasets::storage_info(body.card())),
        op::GET_OBJECT_HANDLES if Objects::is_card(request.parameter(0)) && body.card().is_some() => {
            Answer::data(datasets::array(&body.objects().handles(request.parameter(2))))
        }
        op::EOS_GET_OBJECTS if Objects::is_card(request.parameter(0)) && body.card().is_some() => {
            Answer::data(datasets::object_list(&body.objects().children(request.parameter(1))))
        }
        op::GET_OBJECT_HANDLES | op::EOS_GET_OBJECTS => Answer::data(datasets::array(&[])),
        op::GET_OBJECT_INFO => match body.objects().entry(request.parameter(0)) {
            Some(entry) => Answer::data(datasets::object_info(&entry)),
            None => Answer::code(code::NO_OBJECT),
        },
        op::DELETE_OBJECT if body.objects().remove(request.parameter(0)) => Answer::code(code::OK),
        op::DELETE_OBJECT => Answer::code(code::NO_OBJECT),
        op::EOS_GET_EVENT => Answer::data(body.take_events()),
        op::EOS_SET_PROPERTY => set_property(&mut body, sent, device),
        op::EOS_REQUEST_PROPERTY => {
            body.announce(request.parameter(0));
            Answer::code(code::OK)
        }
        op::EOS_SET_EVENT_MODE => {
            if request.parameter(0) != 0 {
                body.announce_all();
            }
            Answer::code(code::OK)
        }
        op::EOS_HOST_CAPACITY => {
            // Noted here, for the question that follows this one never ends.
            device.faults().strike(|f| *f == Fault::NoRoom);
            body.announce(prop::SHOTS_LEFT);
            Answer::code(code::OK)
        }
        op::EOS_RELEASE_ON if request.parameter(0) & FULL_PRESS != 0 => {
            drop(body);
            Answer::code(release(device)?)
        }
        op::EOS_VIEWFINDER if !body.live() => Answer::code(code::NOT_READY),
        op::EOS_VIEWFINDER => {
            drop(body);
            let jpeg = device.view.preview();
            let mut data = datasets::u32s(&[8 + jpeg.len() as u32, 1]);
            data.extend(jpeg);
            Answer::data(data)
        }
        op::GET_PARTIAL_OBJECT | op::GET_OBJECT => {
            let (from, length) = match request.operation {
                op::GET_OBJECT => (0, u32::MAX),
                _ => (request.parameter(1), request.parameter(2)),
            };
            let part = body.objects().part(request.parameter(0), from, length);
            drop(body);
            match part {
                Some(Some(part)) => return Ok(download(device, Answer::data(part))),
                Some(None) => Answer::code(code::BAD_PARAMETER),
                None => Answer::code(code::NO_OBJECT),
            }
        }
        op::EOS_TRANSFER_COMPLETE if body.objects().remove(request.parameter(0)) => Answer::code(code::OK),
        op::EOS_TRANSFER_COMPLETE => Answer::code(code::NO_OBJECT),
        op::OPEN_SESSION
        | op::CLOSE_SESSION
        | op::EOS_SET_REMOTE_MODE
        | op::EOS_LOCK_UI
        | op::EOS_UNLOCK_UI
        | op::EOS_KEEP_ON
        | op::EOS_RELEASE_ON
        | op::EOS_RELEASE_OFF
        | op::EOS_OLC_GROUPS
        | op::EOS_END_VIEWFINDER => Answer::code(code::OK),
        _ => Answer::code(code::UNSUPPORTED),
    }))
}

/// A part of a file on its way out.
fn download(device: &Arc<Device>, answer: Answer) -> Outcome {
    match device.faults().strike(|f| matches!(f, Fault::DropInDownload | Fault::UnplugInDownload)) {
        Some(fault) => Outcome::CutOff { answer, unplug: fault == Fault::UnplugInDownload },
        None => Outcome::Answer(answer),
    }
}

/// A property from the client.
fn set_property(body: &mut Body, sent: &[u8], device: &Arc<Device>) -> Answer {
    let Some((property, value)) = parse_set(sent) else {
        return Answer::code(code::BAD_PARAMETER);
    };
    // The library itself sets these two when it opens and closes; a body that ignored them could not be used at all.
    let housekeeping = [prop::TARGET, prop::EVF_OUTPUT].contains(&property);
    if !housekeeping && device.faults().strike(|f| *f == Fault::SetIgnored).is_some() {
        body.announce(property);
        return Answer::code(code::OK);
    }
    Answer::code(match body.set(property, value) {
        Ok(()) => code::OK,
        Err(SetError::Unknown) => code::NO_PROPERTY,
        Err(SetError::Value) => code::BAD_VALUE,
    })
}

/// Whether a fault is one that becomes of an exposed frame; the first frame of all has none before it to repeat.
fn shapes_a_frame(fault: &Fault, has_last: bool) -> bool {
    match fault {
        Fault::NeverAnnounced
        | Fault::LateObject(_)
        | Fault::DoubledObject
        | Fault::CutObject { .. }
        | Fault::CutDownload { .. }
        | Fault::HollowObject { .. }
        | Fault::ShortFile { .. }
        | Fault::WrongExif
        | Fault::SlowReady(_) => true,
        Fault::RepeatedFrame => has_last,
        _ => false,
    }
}

/// Opens the shutter: answers at once, while the frame is exposed on the shutter's own thread.
fn release(device: &Arc<Device>) -> io::Result<u16> {
    device.faults().count_release();
    let refusal = device.faults().strike(|f| {
        matches!(
            f,
            Fault::LowBattery | Fault::BusyOnce | Fault::BusyFor(_) | Fault::NoFocus | Fault::FocusHunt(_)
        )
    });
    match refusal {
        Some(Fault::LowBattery | Fault::NoFocus) => return Ok(code::GENERAL),
        Some(Fault::FocusHunt(time)) => {
            device.pause(time);
            return Ok(code::BUSY);
        }
        Some(_) => return Ok(code::BUSY),
        None => {}
    }
    let mut body = device.body()?;
    if body.busy() {
        return Ok(code::BUSY);
    }
    if !body.to_computer() {
        let full = device.faults().strike(|f| *f == Fault::CardFull).is_some();
        match body.card() {
            _ if full => return Ok(code::STORE_FULL),
            None => return Ok(code::NO_CARD),
            Some((_, left)) if (left as usize) < body.kinds().len() => return Ok(code::STORE_FULL),
            Some(_) => {}
        }
    }
    let Some(mut exposure) = body.exposure() else {
        return Ok(code::GENERAL);
    };
    let has_last = body.has_last_frame();
    let fault = device.faults().strike(|f| shapes_a_frame(f, has_last));
    if fault == Some(Fault::WrongExif) {
        exposure.shutter = dials::one_stop_off(exposure.shutter);
    }
    body.begin_exposure();
    let frame = Frame { exposure, kinds: body.kinds(), delay: body.delay(), fault };
    drop(body);
    device.expose(frame)?;
    Ok(code::OK)
}
