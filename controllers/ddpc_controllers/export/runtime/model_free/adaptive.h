/* Model-free adaptive control, MFAC and MFAPC, with equations (14)-(21): mfac.py, models/data_model.py and
 * models/data_model_prediction.py. */
#ifndef ADAPTIVE_H
#define ADAPTIVE_H

#include "change_limits.h"
#include "linearised_prediction.h"
#include "sample.h"

#include <stdbool.h>

typedef struct {
    const LinearisedPrediction *prediction;
    size_t forecast_order; /* n_m; 0: a gradient counts as constant */
    bool assume_sign;
    double eta, mu, epsilon, delta, theta_0, theta_limit;
    double step_factor;
    const double *ridge;   /* Nu m: lambda */
    const double *initial; /* Phi_1: p rows of the coefficients of one output */
    const ChangeLimits *limits;
} Adaptive;

/* Of a row of coefficients there are w = Ly + Lu with the diagonal structure, p Ly + m Lu otherwise. */
typedef struct {
    double *begun;    /* whether `y` is known */
    double *y;        /* p */
    double *changes;  /* p Ly of the outputs, m Lu of the inputs, newest first */
    double *u;        /* m */
    double *gradients; /* p x w */
    double *theta;     /* p x w x n_m */
    double *past;      /* p x w x (n_m + 1), newest first */
    double *h;         /* w, of this step only */
    PredictionMemory prediction;
    ChangeLimitsMemory limits;
} AdaptiveMemory;

void adaptive_step(const Adaptive *adaptive, const AdaptiveMemory *held, const Sample *sample, double u[], Told *told);

#endif
