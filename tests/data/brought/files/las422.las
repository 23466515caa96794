~Version ---------------------------------------------------
VERS.   2.0 : CWLS log ASCII Standard -VERSION 2.0
WRAP.    NO : One line per depth step
DLM . SPACE : Column Data Section Delimiter
~Well ------------------------------------------------------
STRT  .ft       0.00000 : START DEPTH
STOP  .ft    4799.23116 : STOP DEPTH
STEP  .ft     436.29374 : STEP
NULL  .        -9999.25 : NULL VALUE
COMP  .                 : COMPANY
WELL  .             B-4 : WELL
FLD   .                 : FIELD
LOC   .                 : LOCATION
PROV  .                 : PROVINCE
CNTY  .                 : COUNTY
STAT  .                 : STATE
CTRY  .                 : COUNTRY
SRVC  .                 : SERVICE COMPANY
DATE  .                 : DATE
UWI   .                 : UNIQUE WELL ID
API   .                 : API NUMBER
XCOORD.ft  1476104.4608 : 
YCOORD.ft 22243415.7773 : 
EKB   .ft        82.021 : 
~Curve Information -----------------------------------------
DEPT  .ft   : 
INCL  .deg  : 
AZIM  .deg  : 
RADIUS.ft   : 
~Params ----------------------------------------------------
~Other -----------------------------------------------------
~ASCII -----------------------------------------------------
    0.00000   30.00000   40.00000    1.64042
  436.29374   30.00000   40.00000    1.64042
  872.58748   30.00000   40.00000    1.64042
 1308.88122   30.00000   40.00000    1.64042
 1745.17497   30.00000   40.00000    1.64042
 2181.46871   30.00000   40.00000    1.64042
 2617.76245   30.00000   40.00000    1.64042
 3054.05619   30.00000   40.00000    1.64042
 3490.34993   30.00000   40.00000    1.64042
 3926.64367   30.00000   40.00000    1.64042
 4362.93741   30.00000   40.00000    1.64042
 4799.23116   30.00000   40.00000    1.64042
