/* Model-free adaptive control, MFAC and MFAPC, with equations (14)-(21): mfac.py, models/data_model.py and
 * models/data_model_prediction.py. */
#ifndef ADAPTIVE_H
#define ADAPTIVE_H

#include "change_limits.h"
#include "sample.h"

#include <stdbool.h>

typedef struct {
    size_t p, m;
    size_t output_length, input_length; /* Ly, Lu: changes of outputs and of inputs in H */
    bool diagonal;                      /* each output follows its own past and input only */
    size_t horizon, control_horizon;    /* N, Nu */
    size_t forecast_order;              /* n_m; 0: a gradient counts as constant */
    bool assume_sign;
    double eta, mu, epsilon, delta, theta_0, theta_limit;
    double lambda_u, step_factor;
    const double *initial;              /* Phi_1: p rows of the coefficients of one output */
    const ChangeLimits *limits;
} Adaptive;

/* Of a row of coefficients there are w = Ly + Lu with the diagonal structure, p Ly + m Lu otherwise; n = Nu m. */
typedef struct {
    double *begun;    /* whether `y` is known */
    double *y;        /* p */
    double *changes;  /* p Ly of the outputs, m Lu of the inputs, newest first */
    double *u;        /* m */
    double *gradients; /* p x w */
    double *theta;     /* p x w x n_m */
    double *past;      /* p x w x (n_m + 1), newest first */
    /* of this step only */
    double *h;         /* w */
    double *ahead;     /* p x N x w: Phi_k ... Phi_k+N-1 */
    double *response;  /* N p x (n + 1): A and f of Y = E y_k + f + A dU */
    double *error;     /* N p: Y* - E y_k - f */
    double *hessian, *factor; /* n x n each */
    double *slope, *plan;     /* n each */
    double *tall;      /* (N p + n) x n */
    ChangeLimitsMemory limits;
} AdaptiveMemory;

void adaptive_step(const Adaptive *adaptive, const AdaptiveMemory *held, const Sample *sample, double u[], Told *told);

#endif
