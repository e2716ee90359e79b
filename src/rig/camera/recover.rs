//! How a camera is brought back, from the gentlest step to the roughest: asked again; its host stopped and another
//! started; looked for at another address of the bus; the USB device reset; then the operator is asked in words.
//!
//! The order is policy, told here over a [`Patient`]; what each step does is the driver's.

use crate::rig::CameraError;

/// A camera that failed, as the policy sees it.
pub(super) trait Patient {
    /// Whether its host still runs.
    fn runs(&mut self) -> bool;
    /// Asks it something harmless.
    fn ask(&mut self) -> Result<(), CameraError>;
    /// Stops the host, starts another, opens the camera in it.
    fn restart(&mut self) -> Result<(), CameraError>;
    /// Whether it hangs on the USB bus.
    fn on_usb(&self) -> bool;
    /// Looks for it on the whole bus, by model and serial number, and opens it where it is now; gives the port.
    fn find_again(&mut self) -> Result<String, CameraError>;
    /// Resets the device, as if it had been plugged out and in.
    fn reset(&mut self) -> Result<(), CameraError>;
    /// Its port.
    fn port(&self) -> &str;
}

/// Brings it back, and tells the steps taken in words. An error says what the operator must do.
pub(super) fn bring_back(patient: &mut impl Patient) -> Result<Vec<String>, CameraError> {
    let mut steps = Vec::new();
    if patient.runs() {
        steps.push("asked the camera again".to_owned());
        if patient.ask().is_ok() {
            return Ok(steps);
        }
    }
    steps.push("stopped the camera's driver and started another".to_owned());
    let mut error = match patient.restart() {
        Ok(()) => return Ok(steps),
        Err(error) => error,
    };
    if patient.on_usb() {
        let away = is_away(&error);
        if !away && !needs_hands(&error) {
            steps.push("reset the camera's USB port".to_owned());
            match patient.reset().and_then(|()| patient.restart()) {
                Ok(()) => return Ok(steps),
                Err(next) => error = next,
            }
        }
        // A camera that was plugged in again, or was reset, has another address.
        if away || is_away(&error) {
            match patient.find_again() {
                Ok(port) => {
                    steps.push(format!("found the camera again on {port}"));
                    return Ok(steps);
                }
                Err(next) => error = next,
            }
        }
    }
    tracing::warn!("camera on {} does not come back after: {}", patient.port(), steps.join(", "));
    Err(ask_the_operator(error, patient.port()))
}

fn is_away(error: &CameraError) -> bool {
    matches!(error, CameraError::NotFound { .. } | CameraError::Unplugged { .. })
}

/// Errors whose own words say what to do; a rougher step would not help.
fn needs_hands(error: &CameraError) -> bool {
    matches!(error, CameraError::Claimed { .. } | CameraError::BatteryLow(_) | CameraError::CardFull(_))
}

fn ask_the_operator(error: CameraError, port: &str) -> CameraError {
    match error {
        error if needs_hands(&error) => error,
        CameraError::NotFound { .. } | CameraError::Unplugged { .. } if port.starts_with("usb:") => {
            CameraError::Unplugged { port: port.to_owned() }
        }
        error => CameraError::Stuck { reason: error.to_string(), advice: advice(port).to_owned() },
    }
}

fn advice(port: &str) -> &'static str {
    if port.starts_with("usb:") {
        "Check the USB cable at both ends (no hub, no extension), switch the camera off and on again, set its auto \
         power off to never (setup menu), take out the battery if it stays dark; if a file manager or another \
         program opened the camera, close it (`systemctl --user stop gvfs-gphoto2-volume-monitor`). `unlit doctor` \
         looks for the rest"
    } else {
        "Check that the camera is switched on, in the same network and in its PC remote mode, set its auto power off \
         to never (setup menu), switch it off and on again; `unlit doctor` looks for the rest"
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A patient whose steps succeed or fail as told, and who notes what was done.
    #[derive(Default)]
    struct Fake {
        running: bool,
        answers: bool,
        restarts: Vec<Option<CameraError>>,
        network: bool,
        found: bool,
        done: Vec<&'static str>,
    }

    impl Patient for Fake {
        fn runs(&mut self) -> bool {
            self.running
        }
        fn ask(&mut self) -> Result<(), CameraError> {
            self.done.push("ask");
            if self.answers { Ok(()) } else { Err(CameraError::Busy("still".into())) }
        }
        fn restart(&mut self) -> Result<(), CameraError> {
            self.done.push("restart");
            match self.restarts.pop() {
                Some(Some(error)) => Err(error),
                _ => Ok(()),
            }
        }
        fn on_usb(&self) -> bool {
            !self.network
        }
        fn find_again(&mut self) -> Result<String, CameraError> {
            self.done.push("find");
            if self.found { Ok("usb:001,005".into()) } else { Err(away().unwrap_or_else(hung)) }
        }
        fn reset(&mut self) -> Result<(), CameraError> {
            self.done.push("reset");
            Ok(())
        }
        fn port(&self) -> &str {
            if self.network { "ptpip:10.0.0.1" } else { "usb:001,004" }
        }
    }

    fn away() -> Option<CameraError> {
        Some(CameraError::NotFound { hint: String::new() })
    }

    fn hung() -> CameraError {
        CameraError::Deadline { operation: "open".into(), deadline: std::time::Duration::from_secs(1) }
    }

    #[test]
    fn a_camera_that_answers_is_left_alone() {
        let mut fake = Fake { running: true, answers: true, ..Fake::default() };
        assert_eq!(bring_back(&mut fake).unwrap(), ["asked the camera again"]);
        assert_eq!(fake.done, ["ask"]);
    }

    #[test]
    fn a_hung_camera_is_restarted_then_reset_then_the_operator_is_asked() {
        let mut fake = Fake { running: true, ..Fake::default() };
        bring_back(&mut fake).unwrap();
        assert_eq!(fake.done, ["ask", "restart"]);
        let mut fake = Fake { restarts: vec![None, Some(hung())], ..Fake::default() };
        assert_eq!(bring_back(&mut fake).unwrap().len(), 2);
        assert_eq!(fake.done, ["restart", "reset", "restart"]);
        let mut fake = Fake { restarts: vec![Some(hung()), Some(hung())], ..Fake::default() };
        let error = bring_back(&mut fake).unwrap_err();
        assert!(matches!(error, CameraError::Stuck { .. }), "{error}");
        for word in ["cable", "auto power off", "gvfs"] {
            assert!(error.to_string().contains(word), "{error}");
        }
    }

    #[test]
    fn a_camera_plugged_in_again_is_found_at_its_new_address() {
        let mut fake = Fake { restarts: vec![away()], found: true, ..Fake::default() };
        assert!(bring_back(&mut fake).unwrap().iter().any(|step| step.contains("usb:001,005")));
        assert_eq!(fake.done, ["restart", "find"], "nothing to reset where nothing is plugged in");
        let mut fake = Fake { restarts: vec![away()], ..Fake::default() };
        assert!(matches!(bring_back(&mut fake).unwrap_err(), CameraError::Unplugged { .. }));
    }

    #[test]
    fn a_port_held_by_another_program_is_not_reset() {
        let claimed = CameraError::Claimed { port: "usb:001,004".into() };
        let mut fake = Fake { restarts: vec![Some(claimed)], ..Fake::default() };
        assert!(matches!(bring_back(&mut fake).unwrap_err(), CameraError::Claimed { .. }));
        assert_eq!(fake.done, ["restart"]);
    }

    #[test]
    fn a_camera_on_the_network_is_not_looked_for_on_the_bus() {
        let mut fake = Fake { network: true, restarts: vec![Some(hung())], ..Fake::default() };
        let error = bring_back(&mut fake).unwrap_err();
        assert!(error.to_string().contains("network"), "{error}");
        assert_eq!(fake.done, ["restart"]);
    }
}
