#include "linearised_prediction.h"

#include "vectors.h"

#include <string.h>

size_t own_outputs(const LinearisedPrediction *prediction) { return prediction->diagonal ? 1 : prediction->p; }
size_t own_inputs(const LinearisedPrediction *prediction) { return prediction->diagonal ? 1 : prediction->m; }

size_t own_changes(const LinearisedPrediction *prediction)
{
    return own_outputs(prediction) * prediction->output_length + own_inputs(prediction) * prediction->input_length;
}

/* One row of dY = W_known known + W_decided dU + W_coming dY, with the rows before it put in for dY; it begins with
 * what else changes the output. */
static void predict_change(const LinearisedPrediction *prediction, const PredictionMemory *held, const double changes[],
                           double acting, size_t k, size_t output)
{
    const size_t p = prediction->p, m = prediction->m, n = prediction->control_horizon * m;
    const size_t first = prediction->diagonal ? output : 0;
    const size_t end_outputs = first + own_outputs(prediction), end_inputs = first + own_inputs(prediction);
    const double *phi = held->ahead + (output * prediction->horizon + k) * own_changes(prediction);
    const double *dy = changes, *du = dy + p * prediction->output_length;
    double *row = held->response + (k * p + output) * (n + 1);
    memset(row, 0, n * sizeof(double));
    row[n] = acting;
    for (size_t lag = 0; lag < prediction->output_length; ++lag) {
        for (size_t i = first; i < end_outputs; ++i, ++phi) {
            if (lag >= k) {
                row[n] += *phi * dy[(lag - k) * p + i];
                continue;
            }
            const double *coming = held->response + ((k - lag - 1) * p + i) * (n + 1);
            for (size_t c = 0; c <= n; ++c) row[c] += *phi * coming[c];
        }
    }
    for (size_t lag = 0; lag < prediction->input_length; ++lag) {
        for (size_t j = first; j < end_inputs; ++j, ++phi) {
            if (lag > k) row[n] += *phi * du[(lag - k - 1) * m + j];
            else if (k - lag < prediction->control_horizon) row[(k - lag) * m + j] += *phi;
        }
    }
}

void predict_outputs(const LinearisedPrediction *prediction, const PredictionMemory *held, const double changes[],
                     const double acting[])
{
    const size_t p = prediction->p, columns = prediction->control_horizon * prediction->m + 1;
    for (size_t k = 0; k < prediction->horizon; ++k)
        for (size_t i = 0; i < p; ++i)
            predict_change(prediction, held, changes, acting != NULL ? acting[k * p + i] : 0.0, k, i);
    for (size_t at = p * columns; at < prediction->horizon * p * columns; ++at)
        held->response[at] += held->response[at - p * columns];
}

void miss_references(const LinearisedPrediction *prediction, const PredictionMemory *held, const double reference[],
                     const double y[])
{
    const size_t p = prediction->p, n = prediction->control_horizon * prediction->m;
    for (size_t k = 0; k < prediction->horizon * p; ++k)
        held->error[k] = reference[k] - y[k % p] - held->response[k * (n + 1) + n];
}

void take_inputs(const LinearisedPrediction *prediction, double changes[], double last[], const double u[])
{
    const size_t m = prediction->m;
    for (size_t j = 0; j < m; ++j) last[j] = u[j] - last[j];
    prepend_sample(changes + prediction->p * prediction->output_length, prediction->input_length, m, last);
    memcpy(last, u, m * sizeof(double));
}
