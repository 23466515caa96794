//! Settings of what is followed.

use super::{Said, bad, finites};
use crate::Result;
use crate::feature::{FeatureKind, LabelOptions};
use crate::image::LabelValue;
use crate::job::asked::{Followed, StrongKind, What};
use crate::job::settings::SeedingName;

/// What is followed, and how it is sought.
pub(super) fn followed(said: &Said) -> Result<Followed> {
    let settings = &said.settings;
    if let Some(sigma) = settings.sigma.filter(|s| !(s.is_finite() && *s > 0.0)) {
        let problem = "is not a positive number of samples";
        let remedy = "omit it, or give about the features' thickness";
        return Err(bad("sigma", sigma, problem, remedy));
    }
    if let Some(threshold) = settings.threshold.filter(|t| !t.is_finite()) {
        let remedy = "omit it: the automatic threshold is printed";
        return Err(bad(
            "threshold",
            threshold,
            "is not a finite number",
            remedy,
        ));
    }
    let wishes = wishes(settings.label.as_deref().unwrap_or_default())?;
    let kind = match settings.feature.unwrap_or(FeatureKind::Auto) {
        FeatureKind::Auto if !wishes.is_empty() => FeatureKind::Labels,
        kind => kind,
    };
    let sized = wishes.iter().find(|wish| wish.distance.is_some());
    if let (Some(wish), Some(SeedingName::Canny)) = (sized, settings.seeding) {
        let problem = "has a distance of its own, but with seeding canny the image determines it";
        return Err(bad("label", wish, problem, "choose another seeding"));
    }
    if kind != FeatureKind::Labels {
        let problem = format!("is about a label, but {kind} are followed");
        said.unused(&["label"], &problem, "follow labels, or omit it")?;
    }
    let threshold = settings.threshold;
    if kind != FeatureKind::Paths {
        let problem = "applies to an object whose boundary is followed by paths";
        said.unused(
            &["object", "background"],
            problem,
            "follow paths, or omit it",
        )?;
    }
    let weights = weights(settings.feature_weights.as_deref())?;
    if kind != FeatureKind::FaultsAndHorizons {
        let problem = "weighs faults against horizons, but they are not followed together";
        said.unused(&["feature-weights"], problem, "follow both, or omit it")?;
    }
    if matches!(
        kind,
        FeatureKind::Labels | FeatureKind::Mask | FeatureKind::Paths
    ) {
        let problem = format!("applies to the strength of features, but {kind} have none");
        said.unused(
            &["threshold"],
            &problem,
            "omit it, or follow other features",
        )?;
    }
    let strong = |kind| What::Strong { kind, threshold };
    Ok(Followed {
        sigma: settings.sigma,
        what: match kind {
            FeatureKind::Auto => strong(StrongKind::Auto),
            FeatureKind::Ridges => strong(StrongKind::Ridges),
            FeatureKind::Valleys => strong(StrongKind::Valleys),
            FeatureKind::Edges => strong(StrongKind::Edges),
            FeatureKind::Canny => strong(StrongKind::Canny),
            FeatureKind::Horizons => strong(StrongKind::Horizons),
            FeatureKind::Faults => strong(StrongKind::Faults),
            FeatureKind::Potential => strong(StrongKind::Potential),
            FeatureKind::Mask => strong(StrongKind::Mask),
            FeatureKind::FaultsAndHorizons => What::FaultsAndHorizons { threshold, weights },
            FeatureKind::Labels => What::Labels { wishes },
            FeatureKind::Paths => What::Paths {
                object: points("object", settings.object.as_deref())?,
                background: points("background", settings.background.as_deref())?,
            },
        },
    })
}

/// What is wanted of labels, each named once.
fn wishes(texts: &[String]) -> Result<Vec<LabelOptions>> {
    let mut wishes: Vec<LabelOptions> = Vec::new();
    for text in texts {
        let wish = LabelOptions::parse(text)
            .map_err(|(problem, remedy)| bad("label", text, &problem, remedy))?;
        if wishes.iter().any(|known| known.label == wish.label) {
            let problem = "is about a label that another one is about, too";
            return Err(bad(
                "label",
                text,
                problem,
                "say all of a label at once, with commas",
            ));
        }
        wishes.push(wish);
    }
    let gone = |into: LabelValue| {
        wishes
            .iter()
            .any(|wish| wish.label == into && wish.merge_into.is_some())
    };
    if let Some(wish) = wishes.iter().find(|wish| wish.merge_into.is_some_and(gone)) {
        let problem = "puts a label into one that is itself put into another";
        return Err(bad("label", wish, problem, "name the last of them"));
    }
    Ok(wishes)
}

/// Two numbers in (0, 1].
fn weights(text: Option<&str>) -> Result<[f64; 2]> {
    let Some(text) = text else {
        return Ok([1.0; 2]);
    };
    match finites(text).as_deref() {
        Some(&[f, h]) if [f, h].iter().all(|w| *w > 0.0 && *w <= 1.0) => Ok([f, h]),
        _ => Err(bad(
            "feature-weights",
            text,
            "is not two numbers above 0 and at most 1",
            "give the weights of faults and horizons, such as 1,0.5",
        )),
    }
}

fn points(name: &str, texts: Option<&[String]>) -> Result<Vec<Vec<f64>>> {
    let point = |text: &String| match finites(text) {
        Some(point) if matches!(point.len(), 2 | 3) => Ok(point),
        _ => Err(bad(name, text, "is not a point", "give a point X,Y")),
    };
    texts.unwrap_or_default().iter().map(point).collect()
}
