/* N steps of the data model dy_k+1 = Phi_k H_k at once: LinearisedPrediction in models/data_model_prediction.py. */
#ifndef LINEARISED_PREDICTION_H
#define LINEARISED_PREDICTION_H

#include <stdbool.h>
#include <stddef.h>

typedef struct {
    size_t p, m;
    size_t output_length, input_length; /* Ly, Lu: changes of outputs and of inputs in H */
    bool diagonal;                      /* each output follows its own past and input only */
    size_t horizon, control_horizon;    /* N, Nu */
} LinearisedPrediction;

/* Of a row of coefficients there are w = Ly + Lu with the diagonal structure, p Ly + m Lu otherwise; n = Nu m. All
 * of it is of one step only. */
typedef struct {
    double *ahead;            /* p x N x w: Phi_k ... Phi_k+N-1 of each output */
    double *response;         /* N p x (n + 1): A and f of Y = E y_k + f + A dU */
    double *error;            /* N p: Y* - E y_k - f */
    double *hessian, *factor; /* n x n each */
    double *slope, *plan;     /* n each */
    double *tall;             /* (N p + n) x n */
} PredictionMemory;

/* How many outputs and inputs one output's change is explained by, and by how many changes of these. */
size_t own_outputs(const LinearisedPrediction *prediction);
size_t own_inputs(const LinearisedPrediction *prediction);
size_t own_changes(const LinearisedPrediction *prediction);

/* A and f, given Phi_k ... Phi_k+N-1 in `ahead`, what is known of H_k, newest first, and what else changes the outputs
 * at each sample, N p numbers or NULL. */
void predict_outputs(const LinearisedPrediction *prediction, const PredictionMemory *held, const double changes[],
                     const double acting[]);

/* Y* - E y_k - f. */
void miss_references(const LinearisedPrediction *prediction, const PredictionMemory *held, const double reference[],
                     const double y[]);

/* Note how the inputs change, newest first, and what they are. */
void take_inputs(const LinearisedPrediction *prediction, double changes[], double last[], const double u[]);

#endif
