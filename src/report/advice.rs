//! Advice that was tried: options that were used on a crop of the image around the worst place of a mesh
//! of labels, and what they changed there.

use serde::Serialize;

use super::certificate::lines::place_text;

/// An option that helps with the issue of a mesh of labels, or that none of those tried does.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Advice {
    /// The issue, as the verdict names it.
    pub issue: String,
    /// The option that helps; `None` if none of those tried does.
    pub option: Option<String>,
    /// Place of the issue, in the coordinates of the image.
    pub at: Vec<f64>,
    /// Numbers of samples along each axis of the crop round it on which options were tried.
    pub crop: Vec<usize>,
    /// The options that were tried, in this order.
    pub trials: Vec<Trial>,
}

/// An option that was tried.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Trial {
    /// The option.
    pub option: String,
    /// The figure that the issue is about, in words.
    pub figure: String,
    /// The figure in the crop without the option.
    pub before: f64,
    /// The figure in the crop with the option; `None` if there is no mesh.
    pub after: Option<f64>,
    /// A figure of the certificate that the option made worse, in words.
    pub worse: Option<String>,
    /// `true` if the figure is better, and no other is worse.
    pub helps: bool,
}

impl Advice {
    /// Returns what the option does, or the options that were tried without effect.
    pub fn suggestion(&self) -> String {
        let place = place_text(&self.at);
        let helpful = self.trials.last().filter(|_| self.option.is_some());
        if let Some(trial) = helpful {
            return format!(
                "on a part of the image around {place}, this changes {} from {} to {}, and makes nothing worse",
                trial.figure,
                number_text(trial.before),
                number_text(trial.after.unwrap_or_default())
            );
        }
        if self.trials.is_empty() {
            return String::from(if self.crop.is_empty() {
                "no option was tried, as the image is too small for trials on a part of it"
            } else {
                "no option was tried, as a part of the image around the place alone does not have this issue"
            });
        }
        let options: Vec<&str> = self.trials.iter().map(|trial| &*trial.option).collect();
        format!(
            "no option that was tried on a part of the image around {place} ({}); an image with more samples there",
            options.join(", ")
        )
    }
}

/// Returns a figure in up to three digits.
fn number_text(number: f64) -> String {
    if number.fract() == 0.0 {
        format!("{number}")
    } else {
        format!("{number:.3}")
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn advice_says_what_an_option_changed_or_what_was_tried() {
        let trial = Trial {
            option: "--distance 2:6".into(),
            figure: "the nodes at which parts touch".into(),
            before: 3.0,
            after: Some(0.0),
            worse: None,
            helps: true,
        };
        let mut advice = Advice {
            issue: "parts touch".into(),
            option: Some(trial.option.clone()),
            at: vec![3.0, 4.5, 5.25],
            crop: vec![20; 3],
            trials: vec![trial],
        };
        let text = advice.suggestion();
        assert!(
            text.contains("(3, 4.5, 5.25)") && text.contains("from 3 to 0"),
            "{text}"
        );
        advice.option = None;
        let text = advice.suggestion();
        assert!(
            text.starts_with("no option") && text.contains("--distance 2:6"),
            "{text}"
        );
        advice.trials.clear();
        assert!(advice.suggestion().contains("does not have this issue"));
        advice.crop.clear();
        assert!(advice.suggestion().contains("too small"));
    }
}
