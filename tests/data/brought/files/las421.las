~Version ---------------------------------------------------
VERS.   2.0 : CWLS log ASCII Standard -VERSION 2.0
WRAP.    NO : One line per depth step
DLM . SPACE : Column Data Section Delimiter
~Well ------------------------------------------------------
STRT  .m      0.00000 : START DEPTH
STOP  .m   1462.80566 : STOP DEPTH
STEP  .m    132.98233 : STEP
NULL  .      -9999.25 : NULL VALUE
COMP  .               : COMPANY
WELL  .           B-4 : WELL
FLD   .               : FIELD
LOC   .               : LOCATION
PROV  .               : PROVINCE
CNTY  .               : COUNTY
STAT  .               : STATE
CTRY  .               : COUNTRY
SRVC  .               : SERVICE COMPANY
DATE  .               : DATE
UWI   .               : UNIQUE WELL ID
API   .               : API NUMBER
XCOORD.m  449916.6397 : 
YCOORD.m 6779793.1289 : 
EKB   .m         25.0 : 
~Curve Information -----------------------------------------
DEPT  .m    : 
INCL  .deg  : 
AZIM  .deg  : 
RADIUS.m    : 
~Params ----------------------------------------------------
~Other -----------------------------------------------------
~ASCII -----------------------------------------------------
    0.00000   30.00000   40.00000    0.50000
  132.98233   30.00000   40.00000    0.50000
  265.96466   30.00000   40.00000    0.50000
  398.94700   30.00000   40.00000    0.50000
  531.92933   30.00000   40.00000    0.50000
  664.91166   30.00000   40.00000    0.50000
  797.89399   30.00000   40.00000    0.50000
  930.87633   30.00000   40.00000    0.50000
 1063.85866   30.00000   40.00000    0.50000
 1196.84099   30.00000   40.00000    0.50000
 1329.82332   30.00000   40.00000    0.50000
 1462.80566   30.00000   40.00000    0.50000
