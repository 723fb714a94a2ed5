/* The optimum without limits: least_changes in optimisation/limits.py. */
#ifndef LEAST_CHANGES_H
#define LEAST_CHANGES_H

#include "linearised_prediction.h"

/* The changes, `plan`, that minimise |error - A dU|^2 + dU' diag(ridge) dU, and half of its second derivatives,
 * `hessian`; NaN where a number is not finite. */
void least_changes(const LinearisedPrediction *prediction, const PredictionMemory *held, const double ridge[]);

#endif
