#include "gpc.h"

#include "least_changes.h"
#include "vectors.h"

#include <math.h>
#include <string.h>

/* What explains a change besides changes of known disturbances, and all of it. */
static size_t model_terms(const GPC *gpc) { return own_changes(gpc->prediction); }
static size_t all_terms(const GPC *gpc)
{
    return model_terms(gpc) + gpc->n_d * (gpc->prediction->input_length + 1);
}

/* Forget the signals: what comes next teaches nothing until phi is known again. */
static void forget(const GPC *gpc, const GPCMemory *held)
{
    const size_t ly = gpc->prediction->output_length, lu = gpc->prediction->input_length;
    *held->begun = 0.0;
    *held->missing = (double)((ly > lu ? ly : lu) + 1);
    memset(held->changes, 0, model_terms(gpc) * sizeof(double));
    memset(held->dd, 0, (lu + 1) * gpc->n_d * sizeof(double));
    memset(held->regressor, 0, all_terms(gpc) * sizeof(double));
    memset(held->target, 0, gpc->prediction->p * sizeof(double));
    memset(held->residual, 0, gpc->prediction->p * sizeof(double));
}

/* Divide a signal by T, one sample further. */
static void filter(const GPC *gpc, double filtered[], const double signal[], size_t n)
{
    for (size_t i = 0; i < n; ++i) filtered[i] = signal[i] + gpc->filtered * filtered[i];
}

/* Take outputs and disturbances of a new sample; return whether there is something to learn. */
static bool observe(const GPC *gpc, const GPCMemory *held, const double y[], const double d[])
{
    const LinearisedPrediction *prediction = gpc->prediction;
    const size_t p = prediction->p, n_d = gpc->n_d, of_model = model_terms(gpc);
    bool teaches = false;
    if (*held->begun != 0.0) {
        for (size_t i = 0; i < p; ++i) held->y[i] = y[i] - held->y[i];
        for (size_t i = 0; i < n_d; ++i) held->d[i] = d[i] - held->d[i];
        prepend_sample(held->dd, prediction->input_length + 1, n_d, held->d);
        if (*held->missing > 0.0) *held->missing -= 1.0;
        teaches = *held->missing == 0.0;
        if (teaches) {
            filter(gpc, held->regressor, held->changes, of_model);
            filter(gpc, held->regressor + of_model, held->dd, all_terms(gpc) - of_model);
            filter(gpc, held->target, held->y, p);
        }
        prepend_sample(held->changes, prediction->output_length, p, held->y);
    }
    memcpy(held->y, y, p * sizeof(double));
    memcpy(held->d, d, n_d * sizeof(double));
    *held->begun = 1.0;
    return teaches;
}

/* What the estimates leave unexplained of the newest sample. */
static void judge(const GPC *gpc, const GPCMemory *held)
{
    const size_t w = all_terms(gpc);
    for (size_t i = 0; i < gpc->prediction->p; ++i)
        held->residual[i] = held->target[i] - dot(held->theta + i * w, held->regressor, w);
}

/* S and the gain after a sample, given S' phi and the weight that is left to those before; return the trace of S S'. */
static double learned(const GPCMemory *held, size_t w, double kept)
{
    const double size = kept + dot(held->seen, held->seen, w), share = 1.0 / (1.0 + sqrt(kept / size));
    for (size_t i = 0; i < w; ++i) {
        held->gain[i] = dot(held->root + i * w, held->seen, w) / size;
        for (size_t j = 0; j < w; ++j)
            held->learned[i * w + j] = (held->root[i * w + j] - share * held->gain[i] * held->seen[j]) / sqrt(kept);
    }
    return dot(held->learned, held->learned, w * w);
}

/* Learn from a sample by recursive least squares (Potter's algorithm). */
static void learn(const GPC *gpc, const GPCMemory *held)
{
    const size_t p = gpc->prediction->p, w = all_terms(gpc);
    bool within = true;
    judge(gpc, held);
    for (size_t i = 0; i < p; ++i) within = within && fabs(held->residual[i]) <= gpc->dead_zone;
    if (within) return;
    memset(held->seen, 0, w * sizeof(double));
    for (size_t i = 0; i < w; ++i)
        for (size_t j = 0; j < w; ++j) held->seen[j] += held->regressor[i] * held->root[i * w + j];
    if (learned(held, w, gpc->forgetting) > gpc->largest_trace) (void)learned(held, w, 1.0);
    memcpy(held->root, held->learned, w * w * sizeof(double));
    for (size_t i = 0; i < p; ++i)
        for (size_t j = 0; j < w; ++j) held->theta[i * w + j] += held->gain[j] * held->residual[i];
    judge(gpc, held);
}

/* What else changes the outputs at each sample of the horizon: the residual, and the changes of disturbances. */
static void act(const GPC *gpc, const GPCMemory *held)
{
    const size_t p = gpc->prediction->p, n_d = gpc->n_d, horizon = gpc->prediction->horizon;
    memset(held->acting, 0, horizon * p * sizeof(double));
    for (size_t i = 0; i < p; ++i) held->acting[i] = -gpc->filtered * held->residual[i];
    for (size_t k = gpc->ahead; k > 0; --k) /* from levels to changes */
        for (size_t i = 0; i < n_d; ++i) held->course[k * n_d + i] -= held->course[(k - 1) * n_d + i];
    for (size_t k = 0; k < horizon; ++k) {
        for (size_t lag = 0; lag <= gpc->prediction->input_length; ++lag) {
            if (lag <= k && k - lag >= gpc->ahead) continue; /* it counts as standing still */
            const double *dd = lag > k ? held->dd + (lag - k - 1) * n_d : held->course + (k - lag + 1) * n_d;
            for (size_t i = 0; i < p; ++i) {
                const double *theta = held->theta + i * all_terms(gpc) + model_terms(gpc) + lag * n_d;
                held->acting[k * p + i] += dot(theta, dd, n_d);
            }
        }
    }
}

/* A and Y* - E y_k - f of the estimates, weighed by the root of Q. */
static void predict_weighed(const GPC *gpc, const GPCMemory *held, const Sample *sample)
{
    const LinearisedPrediction *prediction = gpc->prediction;
    const PredictionMemory *plan = &held->prediction;
    const size_t p = prediction->p, n = prediction->control_horizon * prediction->m, terms = model_terms(gpc);
    for (size_t i = 0; i < p * prediction->horizon; ++i) { /* the same at each sample */
        const double *theta = held->theta + i / prediction->horizon * all_terms(gpc);
        memcpy(plan->ahead + i * terms, theta, terms * sizeof(double));
    }
    act(gpc, held);
    predict_outputs(prediction, plan, held->changes, held->acting);
    miss_references(prediction, plan, sample->reference, sample->y);
    for (size_t k = 0; k < prediction->horizon * p; ++k) {
        for (size_t j = 0; j < n; ++j) plan->response[k * (n + 1) + j] *= gpc->roots[k % p];
        plan->error[k] *= gpc->roots[k % p];
    }
}

void gpc_step(const GPC *gpc, const GPCMemory *held, const Sample *sample, double u[], Told *told)
{
    const LinearisedPrediction *prediction = gpc->prediction;
    const size_t m = prediction->m;
    if (!all_finite(sample->y, prediction->p) || !all_finite(held->course, gpc->n_d)) {
        forget(gpc, held);
        memcpy(u, held->u, m * sizeof(double));
        told->status |= STATUS_HELD;
        return;
    }
    if (observe(gpc, held, sample->y, held->course)) learn(gpc, held);
    if (sample->applied != NULL) {
        take_inputs(prediction, held->changes, held->u, sample->applied);
        memcpy(u, sample->applied, m * sizeof(double));
        return;
    }
    predict_weighed(gpc, held, sample);
    least_changes(prediction, &held->prediction, gpc->ridge);
    limit_changes(gpc->limits, &held->limits, held->u, held->prediction.plan, held->prediction.hessian, u, told);
    take_inputs(prediction, held->changes, held->u, u);
}
