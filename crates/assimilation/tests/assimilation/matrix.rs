//! Dense linear algebra of the tests' references, and the references themselves.

use crate::models::*;
use varda_assimilation::*;
use varda_covariance::Covariance;
use varda_implicit::Model;

/// By rows.
#[derive(Clone)]
pub(crate) struct Matrix {
    rows: usize,
    columns: usize,
    data: Vec<f64>,
}

impl Matrix {
    pub(crate) fn new(rows: usize, columns: usize, entry: impl Fn(usize, usize) -> f64) -> Self {
        let data = (0..rows * columns).map(|i| entry(i / columns, i % columns)).collect();
        Self { rows, columns, data }
    }
    pub(crate) fn of(b: &dyn Covariance) -> Self {
        let n = b.dim();
        let columns: Vec<Vec<f64>> = (0..n)
            .map(|j| {
                let (mut unit, mut column) = (vec![0.0; n], vec![0.0; n]);
                unit[j] = 1.0;
                b.apply(&unit, &mut column);
                column
            })
            .collect();
        Self::new(n, n, |i, j| columns[j][i])
    }
    pub(crate) fn diagonal(d: &[f64]) -> Self {
        Self::new(d.len(), d.len(), |i, j| if i == j { d[i] } else { 0.0 })
    }
    pub(crate) fn column(x: &[f64]) -> Self {
        Self::new(x.len(), 1, |i, _| x[i])
    }
    pub(crate) fn at(&self, i: usize, j: usize) -> f64 {
        self.data[i * self.columns + j]
    }
    pub(crate) fn column_at(&self, j: usize) -> Vec<f64> {
        (0..self.rows).map(|i| self.at(i, j)).collect()
    }
    pub(crate) fn by_columns(&self) -> Vec<f64> {
        self.transpose().data
    }
    pub(crate) fn transpose(&self) -> Self {
        Self::new(self.columns, self.rows, |i, j| self.at(j, i))
    }
    pub(crate) fn times(&self, other: &Self) -> Self {
        Self::new(self.rows, other.columns, |i, j| {
            (0..self.columns).map(|k| self.at(i, k) * other.at(k, j)).sum()
        })
    }
    pub(crate) fn apply(&self, x: &[f64]) -> Vec<f64> {
        self.times(&Self::column(x)).data
    }
    pub(crate) fn plus(&self, other: &Self) -> Self {
        Self::new(self.rows, self.columns, |i, j| self.at(i, j) + other.at(i, j))
    }
    pub(crate) fn minus(&self, other: &Self) -> Self {
        Self::new(self.rows, self.columns, |i, j| self.at(i, j) - other.at(i, j))
    }
    /// self⁻¹ other, by elimination with partial pivoting.
    pub(crate) fn solve(&self, other: &Self) -> Self {
        let (n, m) = (self.rows, other.columns);
        let mut a: Vec<Vec<f64>> = (0..n)
            .map(|i| (0..n).map(|j| self.at(i, j)).chain((0..m).map(|j| other.at(i, j))).collect())
            .collect();
        for k in 0..n {
            let pivot = (k..n).max_by(|&i, &j| a[i][k].abs().total_cmp(&a[j][k].abs())).unwrap();
            a.swap(k, pivot);
            let row = a[k].clone();
            for (_, other) in a.iter_mut().enumerate().filter(|(i, _)| *i != k) {
                let factor = other[k] / row[k];
                (k..n + m).for_each(|j| other[j] -= factor * row[j]);
            }
        }
        Self::new(n, m, |i, j| a[i][n + j] / a[i][i])
    }
}

/// H of a set whose operators are linear and at step 0.
pub(crate) fn observation_matrix(set: &mut ObservationSet, n: usize) -> Matrix {
    let columns: Vec<Vec<f64>> = (0..n)
        .map(|j| {
            let (mut unit, mut y) = (vec![0.0; n], set.prediction());
            unit[j] = 1.0;
            set.observe_add(0, &unit, &mut y).unwrap();
            y.values().to_vec()
        })
        .collect();
    Matrix::new(set.dim(), n, |i, j| columns[j][i])
}

/// M of a linear model.
pub(crate) fn step_matrix(model: &mut dyn Model, n: usize) -> Matrix {
    let columns: Vec<Vec<f64>> = (0..n)
        .map(|j| {
            let mut unit = vec![0.0; n];
            unit[j] = 1.0;
            run(model, &unit, 1).pop().unwrap()
        })
        .collect();
    Matrix::new(n, n, |i, j| columns[j][i])
}

/// A linear window with three of n components seen at four times, the last at its end.
pub(crate) fn linear_window(n: usize, steps: usize) -> (Rk4<Linear>, Vec<f64>, ObservationSet) {
    let field = Linear(n, normals(20, n * n).iter().map(|a| 0.5 * a).collect());
    let values = normals(22, 12);
    let observations = (0..4)
        .map(|j| {
            let step = [0, steps / 4, steps / 2, steps][j];
            observation(&[j % 2, 2, 3], step, 0.0, &values[3 * j..3 * j + 3], 0.3 + 0.1 * j as f64)
        })
        .collect();
    let set = ObservationSet::new(steps, vec![all_of(n)], observations).unwrap();
    (Rk4::new(field, 0.1), normals(21, n), set)
}

type Estimates = Vec<(Vec<f64>, Matrix)>;

/// Means and covariances of every step: filtered (analyses), and smoothed over the window by Rauch, Tung and
/// Striebel (1965). The operators of `set` must be whole states, its times whole steps; errors of different
/// observations are independent.
pub(crate) fn kalman(
    step: &Matrix,
    b: &Matrix,
    q: Option<&Matrix>,
    background: &[f64],
    set: &ObservationSet,
    steps: usize,
) -> (Estimates, Estimates) {
    let n = background.len();
    let (mut x, mut p) = (background.to_vec(), b.clone());
    let (mut forecasts, mut filtered): (Estimates, Estimates) = (Vec::new(), Vec::new());
    let (m, errors) = (set.dim(), set.error_covariance());
    for k in 0..=steps {
        if k > 0 {
            x = step.apply(&x);
            p = step.times(&p).times(&step.transpose());
            if let Some(q) = q {
                p = p.plus(q);
            }
        }
        forecasts.push((x.clone(), p.clone()));
        for (of_set, o) in set.observations().iter().enumerate().filter(|(_, o)| o.step == k) {
            let h = Matrix::new(o.rows.len(), n, |i, j| if o.rows[i] == j { 1.0 } else { 0.0 });
            let first = set.rows(of_set).start;
            let r = Matrix::new(o.rows.len(), o.rows.len(), |i, j| errors[first + i + (first + j) * m]);
            let hp = h.times(&p);
            // Kᵀ = S⁻¹ H P.
            let kt = hp.times(&h.transpose()).plus(&r).solve(&hp);
            let d: Vec<f64> = o.values.iter().zip(h.apply(&x)).map(|(y, p)| y - p).collect();
            x.iter_mut().zip(kt.transpose().apply(&d)).for_each(|(x, dx)| *x += dx);
            p = p.minus(&kt.transpose().times(&hp));
        }
        filtered.push((x.clone(), p.clone()));
    }
    let mut smoothed = vec![filtered[steps].clone()];
    for k in (0..steps).rev() {
        let (x, p) = &filtered[k];
        let (forecast, p_forecast) = &forecasts[k + 1];
        let (later, p_later) = &smoothed[0];
        // Cᵀ = P_f⁻¹ M P.
        let c = p_forecast.solve(&step.times(p)).transpose();
        let change: Vec<f64> = later.iter().zip(forecast).map(|(l, f)| l - f).collect();
        let x = x.iter().zip(c.apply(&change)).map(|(x, d)| x + d).collect();
        let p = p.plus(&c.times(&p_later.minus(p_forecast)).times(&c.transpose()));
        smoothed.insert(0, (x, p));
    }
    (filtered, smoothed)
}

/// Taylor slope 2 ± 0.05, differences, and the same bits after going elsewhere and back, at two controls in
/// turn.
pub(crate) fn check_gradient(cost: &mut dyn CostFunction, one: &[f64], two: &[f64]) {
    let n = cost.dim();
    let (mut g1, mut g2, mut again) = (vec![0.0; n], vec![0.0; n], vec![0.0; n]);
    let j1 = cost.evaluate(one, Some(&mut g1)).unwrap();
    let j2 = cost.evaluate(two, Some(&mut g2)).unwrap();
    for (v, g, j) in [(one, &g1, j1), (two, &g2, j2)] {
        let slope = crate::cost::taylor_slope(cost, v, g);
        assert!((slope - 2.0).abs() <= 0.05, "{slope}");
        let error = crate::cost::relative(&crate::cost::difference_gradient(cost, v), g);
        assert!(error <= 1e-7, "{error:e}");
        assert_eq!(cost.evaluate(v, Some(&mut again)).unwrap(), j);
        assert_eq!(&again, g);
    }
}
