use super::*;

fn outcome(json: &str, analysis: &str) -> Outcome {
    let mut summary = BTreeMap::new();
    flatten(&serde_json::from_str(json).unwrap(), String::new(), &mut summary);
    Outcome { summary, tables: [("analysis.csv".to_string(), Csv::read(analysis))].into() }
}

fn sample(j: f64, iterations: usize, steps: usize, x: f64) -> Outcome {
    let json = format!(
        r#"{{"status": "converged", "j_background": 100.0, "j_analysis": {j},
            "outer_iterations": {iterations}, "counts": {{"model_steps": {steps}}},
            "gradient_norm_last": 1e-9,
            "peak_bytes": {steps},
            "rmse": {{"position_analysis": 0.5, "velocity_analysis": null}}}}"#
    );
    outcome(&json, &format!("index,name,x_a\n0,x,{x}\n1,y,2.0\n"))
}

/// Whether a scene is beyond its bounds, and all verdicts.
fn verdicts(scene: &str, old: &Outcome, new: &Outcome) -> (bool, Vec<String>) {
    let lines = compared(scene, old, new, false);
    (lines.iter().any(|l| l.bad), lines.into_iter().map(|l| l.verdict).collect())
}

#[test]
fn rounding_is_no_difference_and_the_seventh_digit_is_one() {
    let old = sample(60.0, 5, 500, 1.0);
    assert!(!verdicts("s", &old, &sample(60.0 + 1e-9, 5, 500, 1.0 + 1e-9)).0);
    let (bad, said) = verdicts("s", &old, &sample(60.0001, 5, 500, 1.0));
    assert!(bad && said.contains(&"DIFFERS".to_string()), "{said:?}");
    let (bad, said) = verdicts("s", &old, &sample(60.0, 5, 500, 1.00001));
    assert!(bad && said.contains(&"DIFFERS".to_string()), "{said:?}");
}

#[test]
fn counts_are_exact_on_the_same_path() {
    let (bad, said) = verdicts("s", &sample(60.0, 5, 500, 1.0), &sample(60.0, 5, 501, 1.0));
    assert!(bad && said[0] == "COUNTS DIFFER", "{said:?}");
}

#[test]
fn another_path_may_take_two_iterations_more_to_the_same_minimum() {
    let old = sample(60.0, 5, 500, 1.0);
    let (bad, said) = verdicts("s", &old, &sample(60.0 + 1e-6, 7, 700, 1.00001));
    assert!(!bad && said[0] == "path differs" && said.contains(&"same minimum".to_string()), "{said:?}");
    assert!(verdicts("s", &old, &sample(60.0, 8, 800, 1.0)).0);
    assert!(verdicts("s", &old, &sample(60.1, 6, 600, 1.0)).0);
}

#[test]
fn case_4_is_held_to_its_minimum_or_a_lower_one() {
    let old = sample(60.0, 50, 5000, 1.0);
    assert!(!verdicts("hanging-rod-case4", &old, &sample(60.0, 80, 8000, 1.1)).0);
    assert!(!verdicts("hanging-rod-case4", &old, &sample(59.0, 80, 8000, 1.1)).0);
    assert!(verdicts("hanging-rod-case4", &old, &sample(61.0, 50, 5000, 1.0)).0);
}

#[test]
fn what_is_missing_fails() {
    let old = sample(60.0, 5, 500, 1.0);
    let mut new = sample(60.0, 5, 500, 1.0);
    new.summary.remove("j_background");
    assert!(verdicts("s", &old, &new).0);
    let mut new = sample(60.0, 5, 500, 1.0);
    new.tables.clear();
    assert!(verdicts("s", &old, &new).0);
    // A column less, a row less, a number that became none; a column more is none of these.
    let table = |text: &str| Csv::read(text);
    let whole = table("a,b\n1,2\n3,4\n");
    let worst = |other: &Csv| whole.differences(other).iter().fold(0.0, |m: f64, d| m.max(d.1));
    assert_eq!(worst(&table("a\n1\n3\n")), f64::INFINITY);
    assert_eq!(worst(&table("a,b\n1,2\n")), f64::INFINITY);
    assert_eq!(worst(&table("a,b\n1,2\n3,\n")), f64::INFINITY);
    assert_eq!(worst(&table("a,b,c\n1,2,9\n3,4,9\n")), 0.0);
}
