#include "least_changes.h"

#include "change_limits.h"
#include "vectors.h"

#include <float.h>
#include <math.h>
#include <string.h>

#define SWEEPS 60

/* Make columns a and b of a matrix, so many rows apart from each other, orthogonal by turning them; and turn
 * those of `turned` with them. True: they were so already. */
static bool orthogonalise(double matrix[], size_t rows, double turned[], size_t n, size_t a, size_t b)
{
    double aa = 0.0, bb = 0.0, ab = 0.0;
    for (size_t i = 0; i < rows; ++i) {
        aa += matrix[i * n + a] * matrix[i * n + a];
        bb += matrix[i * n + b] * matrix[i * n + b];
        ab += matrix[i * n + a] * matrix[i * n + b];
    }
    if (!(fabs(ab) > DBL_EPSILON * sqrt(aa * bb))) return true;
    const double zeta = (bb - aa) / (2.0 * ab), t = copysign(1.0, zeta) / (fabs(zeta) + hypot(1.0, zeta));
    const double cosine = 1.0 / hypot(1.0, t), sine = cosine * t;
    for (size_t i = 0; i < rows + n; ++i) {
        double *row = i < rows ? matrix + i * n : turned + (i - rows) * n;
        const double left = row[a], right = row[b];
        row[a] = cosine * left - sine * right;
        row[b] = sine * left + cosine * right;
    }
    return false;
}

/* The shortest of the least-squares solutions of [A; diag(ridge)^1/2] dU = [error; 0], by one-sided Jacobi
 * rotations: for a ridge that is lost in the rounding of A'A. */
static void solve_least_squares(const LinearisedPrediction *prediction, const PredictionMemory *held,
                                const double ridge[])
{
    const size_t n = prediction->control_horizon * prediction->m, equations = prediction->horizon * prediction->p;
    double *stacked = held->tall, *turned = held->factor, largest = 0.0;
    for (size_t i = 0; i < equations; ++i)
        memcpy(stacked + i * n, held->response + i * (n + 1), n * sizeof(double));
    for (size_t i = 0; i < n * n; ++i) {
        turned[i] = i % (n + 1) == 0 ? 1.0 : 0.0;
        stacked[equations * n + i] = turned[i] * sqrt(ridge[i / n]);
    }
    bool done = false;
    for (int sweep = 0; sweep < SWEEPS && !done; ++sweep) {
        done = true;
        for (size_t b = 1; b < n; ++b)
            for (size_t a = 0; a < b; ++a) done = orthogonalise(stacked, equations + n, turned, n, a, b) && done;
    }
    for (size_t j = 0; j < n; ++j) {
        double squared = 0.0;
        for (size_t i = 0; i < equations + n; ++i) squared += stacked[i * n + j] * stacked[i * n + j];
        held->slope[j] = sqrt(squared);
        largest = fmax(largest, held->slope[j]);
        held->plan[j] = 0.0;
    }
    for (size_t j = 0; j < n; ++j) {
        const double singular = held->slope[j];
        if (!(singular > DBL_EPSILON * (double)(equations + n) * largest)) continue;
        double projected = 0.0;
        for (size_t i = 0; i < equations; ++i) projected += stacked[i * n + j] / singular * held->error[i];
        for (size_t i = 0; i < n; ++i) held->plan[i] += turned[i * n + j] * (projected / singular);
    }
}

/* The lower triangle of A'A + diag(ridge), and A' error. A is triangular: no output follows what comes after it. */
static void set_normal_equations(const LinearisedPrediction *prediction, const PredictionMemory *held,
                                 const double ridge[])
{
    const size_t p = prediction->p, m = prediction->m, n = prediction->control_horizon * m;
    const size_t horizon = prediction->horizon;
    for (size_t i = 0; i < n; ++i) {
        double *entries = held->hessian + i * n, slope = 0.0;
        /* Outputs that do not follow their own past are where the change takes them after so many samples. */
        const size_t arrived = i / m + prediction->input_length;
        const size_t different = prediction->output_length > 0 || arrived > horizon ? horizon : arrived;
        memset(entries, 0, i * sizeof(double));
        entries[i] = ridge[i];
        for (size_t k = i / m * p; k < different * p; ++k) {
            const double *row = held->response + k * (n + 1);
            const double times = k < (different - 1) * p ? 1.0 : (double)(horizon - different + 1);
            const double share = times * row[i];
            for (size_t j = 0; j <= i; ++j) entries[j] += share * row[j];
        }
        for (size_t k = i / m * p; k < horizon * p; ++k) slope += held->response[k * (n + 1) + i] * held->error[k];
        held->slope[i] = slope;
    }
}

void least_changes(const LinearisedPrediction *prediction, const PredictionMemory *held, const double ridge[])
{
    const size_t n = prediction->control_horizon * prediction->m;
    set_normal_equations(prediction, held, ridge);
    memcpy(held->plan, held->slope, n * sizeof(double));
    bool finite = all_finite(held->slope, n);
    for (size_t i = 0; i < n; ++i) finite = finite && isfinite(held->hessian[i * (n + 1)]); /* the largest */
    if (!finite) {
        held->plan[0] = NAN;
        return;
    }
    if (!factorise(held->hessian, held->factor, n)) {
        solve_least_squares(prediction, held, ridge);
        return;
    }
    for (size_t i = 0; i < n; ++i)
        held->plan[i] = (held->plan[i] - dot(held->factor + i * n, held->plan, i)) / held->factor[i * n + i];
    for (size_t i = n; i-- > 0;) {
        const double *row = held->factor + i * n;
        held->plan[i] /= row[i];
        for (size_t j = 0; j < i; ++j) held->plan[j] -= row[j] * held->plan[i];
    }
}
